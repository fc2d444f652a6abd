//! All Gaussians of all inputs in one set of arrays: decoded in parallel, each to where it stays.

use std::ops::{AddAssign, Range};

use glam::{DVec3, Mat3, Vec3};
use rayon::prelude::*;

use super::CHUNK;
use super::pages::untouched;
use super::sanitize::{Dropped, FileGaussian, Selection, WorldFromFile, WorldGaussian};
use super::source::SplatSource;
use crate::error::Result;
use crate::scene::Splats;
use crate::scene::sh::coefficient_count;

/// Arrays allocated once for every Gaussian that the inputs may bring, filled from the front.
pub(super) struct Gathering {
    splats: Splats,
    filled: usize,
}

/// What an input, or a part of it, brought.
pub(super) struct Gathered {
    /// Where its Gaussians are.
    pub range: Range<usize>,
    pub dropped: Dropped,
    /// Highest band with a coefficient that is not zero, among the Gaussians kept.
    pub sh_degree_used: u8,
}

/// The next part's joins what is there.
impl AddAssign for Gathered {
    fn add_assign(&mut self, next: Self) {
        self.range.end = next.range.end;
        self.dropped += next.dropped;
        self.sh_degree_used = self.sh_degree_used.max(next.sh_degree_used);
    }
}

/// What one chunk of a part brought.
#[derive(Default)]
struct ChunkOutcome {
    kept: usize,
    dropped: Dropped,
    sh_degree_used: u8,
}

/// The slots that one chunk may fill.
struct ChunkSlots<'a> {
    means: &'a mut [Vec3],
    unit_from_world: &'a mut [Mat3],
    opacities: &'a mut [f32],
    sh: &'a mut [f32],
}

impl Gathering {
    /// Room for `count` Gaussians of `sh_degree`.
    pub fn new(count: usize, sh_degree: u8) -> Self {
        let splats = Splats {
            means: untouched(count),
            unit_from_world: untouched(count),
            opacities: untouched(count),
            sh_degree,
            sh: untouched(count * 3 * coefficient_count(sh_degree)),
            linear: Vec::new(),
        };
        Self { splats, filled: 0 }
    }

    /// What an input has brought before its first part.
    pub fn nothing(&self) -> Gathered {
        Gathered { range: self.filled..self.filled, dropped: Dropped::default(), sh_degree_used: 0 }
    }

    /// Decodes all of `source`, drops what cannot be used or is not asked for, and keeps the rest, relative to `origin`.
    ///
    /// Each chunk fills its own slots from the front; afterwards the last Gaussians move to where others were dropped, so
    /// that no more move than that. Within a chunk, file order is kept.
    pub fn append(
        &mut self,
        source: &dyn SplatSource,
        world_from_file: &WorldFromFile,
        selection: &Selection,
        origin: DVec3,
    ) -> Result<Gathered> {
        let first = self.filled;
        let range = first..first + source.count();
        let stride = self.splats.sh_stride();
        let degrees = Degrees { file: source.sh_degree(), stored: self.splats.sh_degree };
        let outcomes: Vec<Result<ChunkOutcome>> = (
            self.splats.means[range.clone()].par_chunks_mut(CHUNK),
            self.splats.unit_from_world[range.clone()].par_chunks_mut(CHUNK),
            self.splats.opacities[range.clone()].par_chunks_mut(CHUNK),
            self.splats.sh[range.start * stride..range.end * stride].par_chunks_mut(CHUNK * stride),
        )
            .into_par_iter()
            .enumerate()
            .map(|(chunk, (means, unit_from_world, opacities, sh))| {
                let mut outcome = ChunkOutcome::default();
                let mut slots = ChunkSlots { means, unit_from_world, opacities, sh };
                source.for_each_in_chunk(chunk, &mut |gaussian| {
                    let placed = world_from_file.place(gaussian, origin).and_then(|world| {
                        selection.check(world_from_file.position(gaussian.mean), gaussian.opacity).map(|()| world)
                    });
                    match placed {
                        Ok(world) => outcome.keep(&mut slots, world, gaussian, degrees),
                        Err(reason) => outcome.dropped.count(reason),
                    }
                })?;
                Ok(outcome)
            })
            .collect();

        let mut dropped = Dropped::default();
        let mut sh_degree_used = 0;
        let mut kept = Vec::with_capacity(outcomes.len());
        // In file order, so that the first error in the file is the one that is told.
        for (chunk, outcome) in outcomes.into_iter().enumerate() {
            let outcome = outcome?;
            let start = first + chunk * CHUNK;
            kept.push(start..start + outcome.kept);
            dropped += outcome.dropped;
            sh_degree_used = sh_degree_used.max(outcome.sh_degree_used);
        }
        self.close_gaps(first, &kept);
        Ok(Gathered { range: first..self.filled, dropped, sh_degree_used })
    }

    /// Makes the Gaussians in the slots `kept`, which lie in chunks from `first` on, one run from `first` on.
    fn close_gaps(&mut self, first: usize, kept: &[Range<usize>]) {
        self.filled = first + kept.iter().map(Range::len).sum::<usize>();
        let mut last = kept.iter().cloned().rev();
        let mut surplus = 0..0;
        for (chunk, kept) in kept.iter().enumerate() {
            let mut gap = kept.end..(first + (chunk + 1) * CHUNK).min(self.filled);
            while gap.start < gap.end {
                if surplus.is_empty() {
                    // There is as much behind the end as is missing before it.
                    let Some(next) = last.next() else { return };
                    surplus = next.start.max(self.filled)..next.end;
                    continue;
                }
                let count = surplus.len().min(gap.len());
                self.move_within(surplus.end - count..surplus.end, gap.start);
                surplus.end -= count;
                gap.start += count;
            }
        }
    }

    fn move_within(&mut self, from: Range<usize>, to: usize) {
        let stride = self.splats.sh_stride();
        self.splats.means.copy_within(from.clone(), to);
        self.splats.unit_from_world.copy_within(from.clone(), to);
        self.splats.opacities.copy_within(from.clone(), to);
        self.splats.sh.copy_within(from.start * stride..from.end * stride, to * stride);
    }

    /// The Gaussians gathered, with bands above `sh_degree` left out.
    pub fn finish(self, sh_degree: u8) -> Splats {
        let mut splats = self.splats;
        let stride = splats.sh_stride();
        splats.means.truncate(self.filled);
        splats.unit_from_world.truncate(self.filled);
        splats.opacities.truncate(self.filled);
        splats.sh.truncate(self.filled * stride);
        splats.lower_sh_degree(sh_degree);
        splats
    }
}

#[derive(Clone, Copy)]
struct Degrees {
    file: u8,
    stored: u8,
}

impl ChunkOutcome {
    /// Puts `world`, with the colours of `gaussian`, into the next free slot. Bands that the file lacks stay zero.
    fn keep(&mut self, slots: &mut ChunkSlots, world: WorldGaussian, gaussian: &FileGaussian, degrees: Degrees) {
        slots.means[self.kept] = world.mean;
        slots.unit_from_world[self.kept] = world.unit_from_world;
        slots.opacities[self.kept] = world.opacity;
        let (from, to) = (coefficient_count(degrees.file), coefficient_count(degrees.stored));
        let channels = gaussian.coefficients.chunks_exact(from).take(3);
        let sh = &mut slots.sh[self.kept * 3 * to..(self.kept + 1) * 3 * to];
        for (stored, channel) in sh.chunks_exact_mut(to).zip(channels.clone()) {
            stored[..from].copy_from_slice(channel);
        }
        let uses =
            |l: usize| channels.clone().any(|channel| channel[l * l..(l + 1) * (l + 1)].iter().any(|&c| c != 0.0));
        let unused_so_far = self.sh_degree_used + 1..=degrees.file;
        self.sh_degree_used = unused_so_far.rev().find(|&l| uses(l.into())).unwrap_or(self.sh_degree_used);
        self.kept += 1;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn closing_gaps_keeps_every_gaussian_once_and_moves_no_more_than_were_dropped() {
        for kept in [[CHUNK, CHUNK, CHUNK], [CHUNK, 0, 10], [CHUNK - 3, 5, 7], [0, 0, 1], [0, 0, 0], [1, CHUNK, 0]] {
            let mut gathering = Gathering::new(3 * CHUNK, 0);
            gathering.splats.opacities.iter_mut().enumerate().for_each(|(i, opacity)| *opacity = i as f32);
            let ranges = [0, 1, 2].map(|chunk| chunk * CHUNK..chunk * CHUNK + kept[chunk]);
            gathering.close_gaps(0, &ranges);
            let total: usize = kept.iter().sum();
            assert_eq!(gathering.filled, total);
            let mut found: Vec<usize> = gathering.splats.opacities[..total].iter().map(|&i| i as usize).collect();
            let moved = found.iter().enumerate().filter(|&(slot, &i)| slot != i).count();
            assert!(moved <= 3 * CHUNK - total, "{kept:?}: {moved}");
            found.sort_unstable();
            assert_eq!(found, ranges.into_iter().flatten().collect::<Vec<_>>(), "{kept:?}");
        }
    }
}
