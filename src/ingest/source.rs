//! What every splat format's reader gives: an opened file whose Gaussians decode chunk by chunk, on any thread.

use std::fmt;
use std::path::PathBuf;
use std::sync::Arc;

use glam::DAffine3;

use super::sanitize::FileGaussian;
use crate::error::Result;
use crate::job::{Frame, Order};
use crate::scene::SplatEncoding;

/// A splat file whose structure has been checked, and what it says about itself.
#[derive(Debug)]
pub(super) struct SplatFile {
    /// Format, version and variant, as reports name them.
    pub format: String,
    /// What the file's axes point at, as it declares or as its format's writers agree.
    pub frame: Frame,
    /// What its colours mean, as it declares or as its format's writers agree.
    pub encoding: SplatEncoding,
    /// The blending order that the file asks for, if it asks for one that a probe can follow.
    pub order: Option<Order>,
    /// One, unless the format places several sets of Gaussians in one file.
    pub parts: Vec<SplatPart>,
    /// Files beside this one that were read.
    pub files: Vec<PathBuf>,
}

/// Gaussians that share a transform.
#[derive(Debug)]
pub(super) struct SplatPart {
    pub file_from_part: DAffine3,
    pub source: Box<dyn SplatSource>,
}

impl SplatPart {
    /// All of a file, as it stands in it.
    pub fn whole(source: impl SplatSource + 'static) -> Vec<Self> {
        vec![Self { file_from_part: DAffine3::IDENTITY, source: Box::new(source) }]
    }
}

/// Gaussians that can be decoded a chunk at a time.
pub(super) trait SplatSource: Send + Sync + fmt::Debug {
    /// How many there are. The file's size has been checked to justify it.
    fn count(&self) -> usize;

    /// Degree of their spherical harmonics, 0 to 4.
    fn sh_degree(&self) -> u8;

    /// Hands the Gaussians of chunk `chunk` (from number `chunk * CHUNK`) to `sink` one by one, in file order. `sink` may
    /// write to what it is given.
    ///
    /// # Errors
    /// [`Error::Invalid`](crate::Error::Invalid) when a Gaussian's data cannot be decoded; names its place in the file.
    fn for_each_in_chunk(&self, chunk: usize, sink: &mut dyn FnMut(&mut FileGaussian)) -> Result<()>;
}

/// A source that several parts share.
impl<T: SplatSource + ?Sized> SplatSource for Arc<T> {
    fn count(&self) -> usize {
        (**self).count()
    }

    fn sh_degree(&self) -> u8 {
        (**self).sh_degree()
    }

    fn for_each_in_chunk(&self, chunk: usize, sink: &mut dyn FnMut(&mut FileGaussian)) -> Result<()> {
        (**self).for_each_in_chunk(chunk, sink)
    }
}

impl SplatFile {
    /// Gaussians of all parts.
    pub fn count(&self) -> usize {
        self.parts.iter().map(|part| part.source.count()).sum()
    }

    /// The highest degree of all parts.
    pub fn sh_degree(&self) -> u8 {
        self.parts.iter().map(|part| part.source.sh_degree()).max().unwrap_or(0)
    }
}
