//! Progress on the terminal, and Ctrl-C.

use std::io::IsTerminal;
use std::sync::RwLock;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use fmmgi_gpu::Progress;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

/// Stages that are shorter get no bar.
const PATIENCE: Duration = Duration::from_secs(1);

/// Set by the first Ctrl-C.
static STOP: AtomicBool = AtomicBool::new(false);

/// Lets the first Ctrl-C end the work cleanly and the second one at once.
pub fn stop_on_ctrl_c() {
    // Without a handler Ctrl-C still ends the program, only less cleanly.
    let _ = ctrlc::set_handler(|| {
        if STOP.swap(true, Ordering::SeqCst) {
            std::process::exit(130);
        }
    });
}

#[derive(Clone, Copy, PartialEq)]
enum Mode {
    Quiet,
    /// Notes only.
    Notes,
    /// Notes and a line for each stage.
    Lines,
    /// Notes and bars.
    Bars,
}

/// Progress on standard error: bars with the time left on a terminal, otherwise lines if wanted.
pub struct Terminal {
    mode: Mode,
    stage: RwLock<Option<Stage>>,
}

struct Stage {
    name: &'static str,
    began: Instant,
    bar: ProgressBar,
}

impl Terminal {
    pub fn new(quiet: bool, verbose: bool) -> Self {
        let mode = match (quiet, std::io::stderr().is_terminal(), verbose) {
            (true, ..) => Mode::Quiet,
            (false, true, _) => Mode::Bars,
            (false, false, true) => Mode::Lines,
            (false, false, false) => Mode::Notes,
        };
        Terminal {
            mode,
            stage: RwLock::new(None),
        }
    }

    /// Ends the stage at work, if any, and begins another.
    fn replace(&self, stage: Option<Stage>) {
        let old = std::mem::replace(&mut *self.stage.write().unwrap(), stage);
        let Some(old) = old else { return };
        old.bar.finish_and_clear();
        if self.mode == Mode::Lines {
            eprintln!("{}: {:.1} s", old.name, old.began.elapsed().as_secs_f64());
        }
    }

    /// Ends the last stage.
    pub fn finish(&self) {
        self.replace(None);
    }
}

impl Progress for Terminal {
    fn stage(&self, name: &'static str, total: u64) {
        if matches!(self.mode, Mode::Quiet | Mode::Notes) {
            return;
        }
        let bar = ProgressBar::with_draw_target(Some(total), ProgressDrawTarget::hidden());
        let style = ProgressStyle::with_template("{msg:12} {wide_bar} {percent:>3}%  {eta} left");
        bar.set_style(style.expect("the template is right"));
        bar.set_message(name);
        let began = Instant::now();
        self.replace(Some(Stage { name, began, bar }));
    }

    fn advance(&self, n: u64) {
        if self.mode != Mode::Bars {
            return;
        }
        if let Some(stage) = &*self.stage.read().unwrap() {
            stage.bar.inc(n);
            if stage.bar.is_hidden() && stage.began.elapsed() > PATIENCE {
                stage.bar.set_draw_target(ProgressDrawTarget::stderr());
            }
        }
    }

    fn note(&self, line: &str) {
        match (self.mode, &*self.stage.read().unwrap()) {
            (Mode::Quiet, _) => {}
            (_, Some(stage)) => stage.bar.suspend(|| eprintln!("{line}")),
            (_, None) => eprintln!("{line}"),
        }
    }

    fn cancelled(&self) -> bool {
        STOP.load(Ordering::Relaxed)
    }
}

impl Drop for Terminal {
    fn drop(&mut self) {
        self.finish();
    }
}
