//! The one error type of the crate, sorted by who must act.

use std::path::PathBuf;

/// Everything that can stop a bake.
///
/// Messages name the file, the place in it, and what to do about it. [`Error::exit_code`] is the process's answer.
#[derive(Debug)]
#[non_exhaustive]
pub enum Error {
    /// The request is wrong: a flag, a job field, or their combination. The caller must change it.
    Request {
        /// The flag or job field, as the user wrote it.
        field: String,
        /// What is wrong with it and what would be right.
        why: String,
    },
    /// A file's content is broken. Whoever made the file must mend it.
    Invalid {
        /// The file.
        path: PathBuf,
        /// Where in the file: a byte offset, a line, a JSON pointer, an element index.
        place: String,
        /// What is wrong there.
        what: String,
    },
    /// A file is well-formed but asks for something this program does not do.
    Unsupported {
        /// The file.
        path: PathBuf,
        /// The feature, by the name that the file's own format gives it, and what to do instead.
        what: String,
    },
    /// An input could not be read.
    Read {
        /// The file.
        path: PathBuf,
        /// The operating system's answer.
        source: std::io::Error,
    },
    /// An output could not be written. Earlier output is untouched, unless files of a bake could not be moved to their places:
    /// what is there then has no manifest.
    Write {
        /// The file or folder.
        path: PathBuf,
        /// The operating system's answer.
        source: std::io::Error,
    },
    /// An input is not what it was when the bake began: what was baked may be of neither version. Earlier output is untouched.
    Changed {
        /// The file.
        path: PathBuf,
    },
    /// The time budget was over before all probes were baked. What is done is written, and the next bake goes on from there.
    Unfinished {
        /// The manifest that was written; it names the rest.
        manifest: PathBuf,
        /// How many probes are missing.
        probes: usize,
    },
    /// Another process works on the output folder.
    Busy {
        /// The folder.
        path: PathBuf,
    },
    /// The bake was stopped from outside before it was done.
    Cancelled,
}

/// `Result` with this crate's [`Error`].
pub type Result<T> = std::result::Result<T, Error>;

impl Error {
    /// A wrong request: `field` as the user wrote it, `why` it cannot be done.
    pub fn request(field: impl Into<String>, why: impl Into<String>) -> Self {
        Self::Request { field: field.into(), why: why.into() }
    }

    /// Broken content in `path` at `place`.
    pub fn invalid(path: impl Into<PathBuf>, place: impl Into<String>, what: impl Into<String>) -> Self {
        Self::Invalid { path: path.into(), place: place.into(), what: what.into() }
    }

    /// The same error of data that `outer` of the file wraps: places are within it.
    pub(crate) fn within(self, outer: &str) -> Self {
        match self {
            Self::Invalid { path, place, what } => Self::Invalid { path, place: format!("{outer}: {place}"), what },
            Self::Unsupported { path, what } => Self::Unsupported { path, what: format!("{outer}: {what}") },
            other => other,
        }
    }

    /// A feature of `path` that this program does not have.
    pub fn unsupported(path: impl Into<PathBuf>, what: impl Into<String>) -> Self {
        Self::Unsupported { path: path.into(), what: what.into() }
    }

    /// An input that the operating system would not give us.
    pub fn read(path: impl Into<PathBuf>, source: std::io::Error) -> Self {
        Self::Read { path: path.into(), source }
    }

    /// An output that the operating system would not take.
    pub fn write(path: impl Into<PathBuf>, source: std::io::Error) -> Self {
        Self::Write { path: path.into(), source }
    }

    /// Process exit code: 2 when the request or an input is wrong, 1 when the bake failed, 3 when its time was over.
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::Request { .. } | Self::Invalid { .. } | Self::Unsupported { .. } | Self::Read { .. } => 2,
            Self::Write { .. } | Self::Changed { .. } | Self::Busy { .. } | Self::Cancelled => 1,
            Self::Unfinished { .. } => 3,
        }
    }
}

impl std::fmt::Display for Error {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Request { field, why } => write!(f, "{field}: {why}"),
            Self::Invalid { path, place, what } => write!(f, "{}: {place}: {what}", path.display()),
            Self::Unsupported { path, what } => write!(f, "{}: not supported: {what}", path.display()),
            Self::Read { path, source } => write!(f, "{}: cannot be read: {source}", path.display()),
            Self::Write { path, source } => write!(f, "{}: cannot be written: {source}", path.display()),
            Self::Changed { path } => {
                write!(f, "{}: changed while it was read; earlier output is untouched: bake again", path.display())
            }
            Self::Unfinished { manifest, probes } => {
                write!(f, "{}: {probes} probes are missing, the time was over: bake again to go on", manifest.display())
            }
            Self::Busy { path } => {
                write!(f, "{}: another bake writes to this folder: wait for it or give another one", path.display())
            }
            Self::Cancelled => write!(f, "stopped before the bake was done; earlier output is untouched"),
        }
    }
}

impl std::error::Error for Error {
    fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
        match self {
            Self::Read { source, .. } | Self::Write { source, .. } => Some(source),
            _ => None,
        }
    }
}
