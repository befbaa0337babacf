//! Stages of a run, kept in a folder, so that a run that was killed goes on where it was.
//!
//! A run goes through the same stages in the same order every time, and each makes the same bits of
//! the same input. So there is no state to restore: a run that begins again reads the results of the
//! stages that are there, and goes on to make the others.

use std::cell::Cell;
use std::fs::{self, File, TryLockError};
use std::io::{self, BufReader, Read, Take, Write};
use std::path::{Path, PathBuf};
use std::thread::sleep;
use std::time::{Duration, Instant};

use serde::Serialize;
use serde::de::DeserializeOwned;
use xxhash_rust::xxh3::Xxh3Default;

use crate::error::{Error, Result};
use crate::output::{self, write_atomic};
use crate::progress::Progress;
use crate::visibility::Counted;

/// The first bytes of a stage's file. The number grows with every change of the format.
const MAGIC: [u8; 8] = *b"fmmgi-c1";
/// Bytes of the checksum at the end. Between are the fingerprint of the run, the number of segments
/// tested so far, and the result.
const CHECKSUM: u64 = 8;
/// Bytes of the longest text in a result: the words of a repair, the name of a kind of links.
const SCRATCH: usize = 1 << 12;
/// What the names of the files begin with; a number follows.
const NAME: &str = "stage-";
/// The file that a run locks.
const LOCK: &str = "in-use";
/// How long a run waits for the lock: one that was killed keeps it until the system has cleared its memory.
const PATIENCE: Duration = Duration::from_secs(5);
/// Between two tries.
const PAUSE: Duration = Duration::from_millis(50);

/// A folder where a run leaves what it has found, stage by stage.
///
/// [`Transport::illuminate_from`](super::Transport::illuminate_from) writes to it and reads from it.
/// As long as the value lives, no other run can use the folder.
#[derive(Debug)]
pub struct Checkpoint {
    folder: PathBuf,
    lock: File,
}

impl Checkpoint {
    /// Makes the folder, if it is not there, and takes hold of it. Waits some seconds for another run to let go.
    ///
    /// # Errors
    /// [`Error::Io`] if it cannot be made or written, [`Error::Input`] if another run uses it,
    /// [`Error::Interrupted`] if `progress` asks to stop.
    pub fn open(folder: &Path, progress: &dyn Progress) -> Result<Checkpoint> {
        let failed = |e| Error::io(folder, "cannot be used as a checkpoint", e);
        let begun = Instant::now();
        let mut told = false;
        loop {
            // Made anew each time: a run that ends well takes both away.
            fs::create_dir_all(folder).map_err(failed)?;
            let lock = File::create(folder.join(LOCK)).map_err(failed)?;
            match lock.try_lock() {
                Ok(()) => {
                    let folder = folder.to_owned();
                    output::remove_temporary(&folder).map_err(failed)?;
                    return Ok(Checkpoint { folder, lock });
                }
                Err(TryLockError::WouldBlock) if begun.elapsed() < PATIENCE => {
                    if !told {
                        let name = folder.display();
                        progress.note(&format!(
                            "checkpoint {name}: waiting for another run to end"
                        ));
                        told = true;
                    }
                    progress.check()?;
                    sleep(PAUSE);
                }
                Err(TryLockError::WouldBlock) => {
                    return Err(Error::input(
                        folder,
                        "is the checkpoint of another run, which has not ended: give each its own folder",
                    ));
                }
                Err(TryLockError::Error(e)) => return Err(failed(e)),
            }
        }
    }

    /// Takes away what was left, once it is of no use any more: after the results are written. The
    /// folder goes too, if nothing else is in it.
    pub fn clear(self) -> Result<()> {
        // The last ones first: whatever is left of them can be gone on from.
        for k in (0..self.stages()?).rev() {
            self.remove(k)?;
        }
        drop(self.lock);
        let path = self.folder.join(LOCK);
        fs::remove_file(&path).map_err(|e| Error::io(&path, "cannot be removed", e))?;
        // It stays where there is more in it.
        let _ = fs::remove_dir(&self.folder);
        Ok(())
    }

    fn path(&self, stage: usize) -> PathBuf {
        self.folder.join(format!("{NAME}{stage:02}"))
    }

    /// One more than the number of the last stage that is there.
    fn stages(&self) -> Result<usize> {
        let failed = |e| Error::io(&self.folder, "cannot be read", e);
        let mut end = 0;
        for entry in fs::read_dir(&self.folder).map_err(failed)? {
            let name = entry.map_err(failed)?.file_name();
            let number = name.to_str().and_then(|name| name.strip_prefix(NAME));
            if let Some(stage) = number.and_then(|number| number.parse::<usize>().ok()) {
                end = end.max(stage + 1);
            }
        }
        Ok(end)
    }

    fn remove(&self, stage: usize) -> Result<()> {
        let path = self.path(stage);
        match fs::remove_file(&path) {
            Err(e) if e.kind() != io::ErrorKind::NotFound => {
                Err(Error::io(path, "cannot be removed", e))
            }
            _ => Ok(()),
        }
    }
}

/// The stages of one run; without a folder nothing is kept.
pub(super) struct Stages<'a> {
    checkpoint: Option<&'a Checkpoint>,
    fingerprint: u64,
    /// What counts the segments. Later stages go by their number, so that it is kept as well.
    counted: &'a Counted<'a>,
    /// The number of the stage that comes next.
    next: Cell<usize>,
    /// How many there are in the folder.
    there: usize,
    /// That of the latest [update](Stages::update).
    latest: Cell<Option<usize>>,
}

impl<'a> Stages<'a> {
    /// Stages that are not kept.
    pub fn unkept(counted: &'a Counted<'a>) -> Stages<'a> {
        Stages {
            checkpoint: None,
            fingerprint: 0,
            counted,
            next: Cell::new(0),
            there: 0,
            latest: Cell::new(None),
        }
    }

    /// The stages of a run whose input and options have this fingerprint.
    ///
    /// Refuses a folder with those of another run, and removes them where one is damaged.
    pub fn new(
        checkpoint: &'a Checkpoint,
        fingerprint: u64,
        counted: &'a Counted<'a>,
        progress: &dyn Progress,
    ) -> Result<Stages<'a>> {
        let there = checkpoint.stages()?;
        let mut stages = Stages {
            checkpoint: Some(checkpoint),
            fingerprint,
            there,
            ..Stages::unkept(counted)
        };
        let mut sound = true;
        for k in 0..there {
            sound &= stages.is_sound(&checkpoint.path(k))?;
        }
        let name = checkpoint.folder.display();
        if !sound {
            progress.note(&format!("checkpoint {name}: damaged, and begun anew"));
            // Without the first one, the others are never taken.
            for k in 0..there {
                checkpoint.remove(k)?;
            }
            stages.there = 0;
        } else if there > 0 {
            progress.note(&format!("checkpoint {name}: {there} stages are done"));
        }
        Ok(stages)
    }

    /// Whether a file is complete and as it was written. One of another run is an error.
    fn is_sound(&self, path: &Path) -> Result<bool> {
        let read = || -> io::Result<Option<u64>> {
            let mut from = Hashed::open(path)?;
            let fingerprint = from.fingerprint()?;
            Ok(from.ends_right()?.then_some(fingerprint).flatten())
        };
        match read() {
            Ok(Some(fingerprint)) if fingerprint != self.fingerprint => Err(Error::input(
                path.parent().unwrap_or(path),
                "is the checkpoint of a run with another input, other options or another version: \
                 give another folder, or remove it",
            )),
            Ok(found) => Ok(found.is_some()),
            Err(e) => match e.kind() {
                io::ErrorKind::NotFound | io::ErrorKind::UnexpectedEof => Ok(false),
                _ => Err(Error::io(path, "cannot be read", e)),
            },
        }
    }

    /// The result of the next stage: that of a run before, or what `make` makes.
    pub fn next<T: Serialize + DeserializeOwned>(
        &self,
        make: impl FnOnce() -> Result<T>,
    ) -> Result<T> {
        match self.read()? {
            Some(result) => Ok(result),
            None => {
                let result = make()?;
                self.write(&result)?;
                Ok(result)
            }
        }
    }

    /// Changes something as the next stage. Only its latest state is kept: those before make way.
    pub fn update<T: Serialize + DeserializeOwned>(
        &self,
        state: &mut T,
        change: impl FnOnce(&mut T) -> Result<()>,
    ) -> Result<()> {
        let stage = self.next.get();
        match self.read::<Option<T>>()? {
            // It has made way for a later one, which will come.
            Some(None) => return Ok(()),
            Some(Some(kept)) => *state = kept,
            None => {
                change(state)?;
                self.write(&Some(&*state))?;
                if let Some(before) = self.latest.get() {
                    self.write_at(before, &None::<T>)?;
                }
            }
        }
        self.latest.set(Some(stage));
        Ok(())
    }

    /// The result of the next stage, if a run before has left it.
    fn read<T: DeserializeOwned>(&self) -> Result<Option<T>> {
        let (Some(checkpoint), stage) = (self.checkpoint, self.next.get()) else {
            return Ok(None);
        };
        if stage >= self.there {
            return Ok(None);
        }
        let path = checkpoint.path(stage);
        let read = || -> io::Result<T> {
            let mut from = Hashed::open(&path)?;
            from.fingerprint()?;
            let segments = from.word()?;
            let from = BufReader::with_capacity(1 << 16, from);
            let (result, _) =
                postcard::from_io((from, &mut [0; SCRATCH])).map_err(io::Error::other)?;
            self.counted.set_segments(u64::from_le_bytes(segments));
            Ok(result)
        };
        let result = read().map_err(|e| Error::io(&path, "cannot be read", e))?;
        self.next.set(stage + 1);
        Ok(Some(result))
    }

    /// Keeps the result of the next stage.
    fn write<T: Serialize>(&self, result: &T) -> Result<()> {
        let stage = self.next.get();
        self.next.set(stage + 1);
        self.write_at(stage, result)
    }

    fn write_at<T: Serialize>(&self, stage: usize, result: &T) -> Result<()> {
        let Some(checkpoint) = self.checkpoint else {
            return Ok(());
        };
        write_atomic(&checkpoint.path(stage), |to| {
            let mut to = Hashed::new(to);
            to.write_all(&MAGIC)?;
            to.write_all(&self.fingerprint.to_le_bytes())?;
            to.write_all(&self.counted.segments().to_le_bytes())?;
            if let Err(e) = postcard::to_io(result, &mut to) {
                // What is in the way says so better itself.
                to.flush()?;
                return Err(io::Error::other(e));
            }
            let sum = to.hash.digest();
            to.inner.write_all(&sum.to_le_bytes())
        })
    }
}

/// What is read or written, with the checksum of all of it so far.
pub(super) struct Hashed<T> {
    inner: T,
    hash: Xxh3Default,
}

impl<T> Hashed<T> {
    fn new(inner: T) -> Hashed<T> {
        Hashed {
            inner,
            hash: Xxh3Default::new(),
        }
    }
}

impl Hashed<Take<File>> {
    /// A file but for its checksum.
    fn open(path: &Path) -> io::Result<Self> {
        let file = File::open(path)?;
        let bytes = file.metadata()?.len().saturating_sub(CHECKSUM);
        Ok(Hashed::new(file.take(bytes)))
    }

    /// The fingerprint that a file begins with, or `None` if it is of another kind.
    fn fingerprint(&mut self) -> io::Result<Option<u64>> {
        let magic = self.word()?;
        let fingerprint = self.word()?;
        Ok((magic == MAGIC).then_some(u64::from_le_bytes(fingerprint)))
    }

    fn word(&mut self) -> io::Result<[u8; 8]> {
        let mut word = [0; 8];
        self.read_exact(&mut word)?;
        Ok(word)
    }

    /// Whether the rest has the checksum that the file ends with.
    fn ends_right(mut self) -> io::Result<bool> {
        io::copy(&mut self, &mut io::sink())?;
        let mut checksum = [0; CHECKSUM as usize];
        self.inner.into_inner().read_exact(&mut checksum)?;
        Ok(u64::from_le_bytes(checksum) == self.hash.digest())
    }
}

impl<T: Read> Read for Hashed<T> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let read = self.inner.read(buffer)?;
        self.hash.update(&buffer[..read]);
        Ok(read)
    }
}

impl<T: Write> Write for Hashed<T> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let written = self.inner.write(bytes)?;
        self.hash.update(&bytes[..written]);
        Ok(written)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.inner.flush()
    }
}

/// A number that stands for a value.
pub(super) fn fingerprint<T: Serialize>(value: &T) -> Result<u64> {
    match postcard::to_io(value, Hashed::new(io::sink())) {
        Ok(to) => Ok(to.hash.digest()),
        Err(e) => Err(Error::Invalid(format!("the input has no fingerprint: {e}"))),
    }
}
