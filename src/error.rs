//! One error type; each kind has its exit code.

use std::path::{Path, PathBuf};

/// What can go wrong, in words for the person who runs the program.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// A file's content cannot be used: which file, and what is wrong where.
    #[error("{}: {message}", path.display())]
    Input { path: PathBuf, message: String },
    /// A file cannot be opened, read or written.
    #[error("{}: {action}: {source}", path.display())]
    Io {
        path: PathBuf,
        action: &'static str,
        source: std::io::Error,
    },
    /// Data handed over in memory cannot be used.
    #[error("{0}")]
    Invalid(String),
    /// The command line asks for something that does not exist or does not fit together.
    #[error("{0}")]
    Usage(String),
    /// The backend or adapter asked for is not there.
    #[error("{0}")]
    NoBackend(String),
    /// The device failed during the work.
    #[error("device: {0}")]
    Device(String),
    /// The work does not fit into memory or its limits.
    #[error("{0}")]
    TooLarge(String),
    /// Stopped by Ctrl-C or by the caller.
    #[error("interrupted; nothing was written")]
    Interrupted,
}

pub type Result<T> = std::result::Result<T, Error>;

impl Error {
    pub fn input(path: impl AsRef<Path>, message: impl Into<String>) -> Self {
        Error::Input {
            path: path.as_ref().to_owned(),
            message: message.into(),
        }
    }

    pub fn io(path: impl AsRef<Path>, action: &'static str, source: std::io::Error) -> Self {
        Error::Io {
            path: path.as_ref().to_owned(),
            action,
            source,
        }
    }

    /// The same error, with the name of the file whose content is meant.
    pub fn about(self, path: impl AsRef<Path>) -> Self {
        match self {
            Error::Invalid(message) => Error::input(path, message),
            other => other,
        }
    }

    /// Exit code of the binary: 1 failed, 2 wrong usage, 3 no such backend, 130 interrupted.
    /// (0 is success and 4 "done, but not converged"; neither is an error.)
    pub fn exit_code(&self) -> u8 {
        match self {
            Error::Usage(_) => 2,
            Error::NoBackend(_) => 3,
            Error::Interrupted => 130,
            _ => 1,
        }
    }
}
