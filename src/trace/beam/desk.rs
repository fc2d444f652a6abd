//! Contributions of a quad that are not finished, in the order of their arrival.

use super::lanes::Lanes;

/// One candidate's contributions to a quad.
#[derive(Clone, Copy)]
pub(super) struct Entry {
    /// Sort key; negative infinity in lanes that it does not contribute to.
    pub key: Lanes,
    /// Depth of the contribution along the face's look axis.
    pub depth: Lanes,
    /// 0 in lanes that it does not contribute to.
    pub alpha: Lanes,
    /// Transmittance of all that precedes it in each lane.
    pub before: Lanes,
    /// Largest key of all earlier arrivals.
    pub latest: Lanes,
    pub colour: Colour,
    /// Of its candidate: of equal keys, that of the lower index comes first.
    pub index: u32,
    /// Whether nothing can arrive before it any more, in any lane.
    pub settled: bool,
}

impl Entry {
    pub const EMPTY: Self = Self {
        key: Lanes::splat(f32::NEG_INFINITY),
        depth: Lanes::splat(0.0),
        alpha: Lanes::splat(0.0),
        before: Lanes::splat(0.0),
        latest: Lanes::splat(0.0),
        colour: Colour::Splat([0.0; 3]),
        index: 0,
        settled: false,
    };
}

/// The colour of an entry; lanes are indices into the tile's list of colours that differ from lane to lane.
#[derive(Clone, Copy)]
pub(super) enum Colour {
    /// The same in all lanes, in the splats' encoding.
    Splat([f32; 3]),
    SplatLanes(u32),
    /// The same in all lanes, linear radiance.
    Linear([f32; 3]),
    LinearLanes(u32),
}

/// Where a quad keeps its unfinished contributions. Quads take turns with a few desks, which stay in the fastest cache
/// that way.
#[derive(Default)]
pub(super) struct Desk {
    /// The first `filled` are in use; the others are kept so that making an entry writes only what it must.
    entries: Vec<Entry>,
    filled: usize,
}

impl Desk {
    /// The entries in use.
    #[inline(always)]
    pub fn entries(&mut self) -> &mut [Entry] {
        &mut self.entries[..self.filled]
    }

    pub fn len(&self) -> usize {
        self.filled
    }

    /// The next `count` entries, to be written and then [`Self::keep`]t. What they hold is of no meaning.
    #[inline(always)]
    pub fn room(&mut self, count: usize) -> &mut [Entry] {
        let end = self.filled + count;
        if self.entries.len() < end {
            self.entries.resize(end, Entry::EMPTY);
        }
        &mut self.entries[self.filled..end]
    }

    /// Takes `count` more entries into use.
    #[inline(always)]
    pub fn keep(&mut self, count: usize) {
        self.filled += count;
    }

    /// Removes the settled entries.
    #[inline(always)]
    pub fn drop_settled(&mut self) {
        let mut kept = 0;
        for k in 0..self.filled {
            if !self.entries[k].settled {
                if kept < k {
                    self.entries[kept] = self.entries[k];
                }
                kept += 1;
            }
        }
        self.filled = kept;
    }

    pub fn clear(&mut self) {
        self.filled = 0;
    }
}
