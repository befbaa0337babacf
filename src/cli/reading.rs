//! How scans are read: the arguments that all commands have in common which read them.

use clap::ValueEnum;
use fmmgi_gpu::scan::ColourSpace;
use fmmgi_gpu::scene::SceneOptions;
use fmmgi_gpu::{Progress, Result, Scene};

#[derive(clap::Args)]
pub struct Reading {
    /// Take the faces of PLY files as the surface, and make points on them
    #[arg(long)]
    mesh: bool,
    /// What the colours of scans are [default: as their values tell; sRGB]
    #[arg(long, value_enum, value_name = "SPACE")]
    colours: Option<Colours>,
    /// Take points that LAS files flag as withheld or noise (classes 7 and 18)
    #[arg(long)]
    keep_flagged: bool,
    /// Take files that lie thousands of their sizes apart
    #[arg(long)]
    far_apart: bool,
    /// What the columns of texts are, by name, _ for those that mean nothing: x,y,z,r,g,b,_
    #[arg(long, value_name = "NAMES", value_delimiter = ',')]
    columns: Vec<String>,
}

#[derive(Clone, Copy, ValueEnum)]
enum Colours {
    /// sRGB of 8 bits: white is 255
    Srgb8,
    /// sRGB of 16 bits: white is 65535
    Srgb16,
    /// Linear light
    Linear,
}

impl Reading {
    pub fn options(&self) -> SceneOptions {
        SceneOptions {
            mesh: self.mesh,
            colours: self.colours.map(|colours| match colours {
                Colours::Srgb8 => ColourSpace::Srgb8,
                Colours::Srgb16 => ColourSpace::Srgb16,
                Colours::Linear => ColourSpace::Linear,
            }),
            far_apart: self.far_apart,
            keep_flagged: self.keep_flagged,
            columns: self.columns.clone(),
            ..SceneOptions::default()
        }
    }
}

/// Tells once what of each file was taken for what, and what is doubtful.
pub fn tell(scene: &Scene, progress: &dyn Progress) -> Result<()> {
    let read = scene
        .sources
        .iter()
        .filter(|source| !source.taken.is_empty());
    for source in read {
        progress.note(&format!("{}: {}", source.path.display(), source.taken));
    }
    for doubt in scene.doubts()? {
        progress.note(&format!("warning: {doubt}"));
    }
    Ok(())
}
