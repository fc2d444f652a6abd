//! Contributions of a block that are not finished: where they are kept, and in which order they arrive.

use super::lanes::Lanes;

/// One candidate's contributions to a block.
#[derive(Clone, Copy)]
pub(super) struct Entry<const N: usize> {
    /// Sort key; negative infinity in lanes that it does not contribute to.
    pub key: Lanes<N>,
    /// Depth of the contribution along the face's look axis.
    pub depth: Lanes<N>,
    /// 0 in lanes that it does not contribute to.
    pub alpha: Lanes<N>,
    /// Transmittance of all that precedes it in each lane.
    pub before: Lanes<N>,
    /// Largest key of all earlier arrivals.
    pub latest: Lanes<N>,
    pub colour: Colour,
}

impl<const N: usize> Entry<N> {
    pub const EMPTY: Self = Self {
        key: Lanes::splat(f32::NEG_INFINITY),
        depth: Lanes::splat(0.0),
        alpha: Lanes::splat(0.0),
        before: Lanes::splat(0.0),
        latest: Lanes::splat(0.0),
        colour: Colour::Splat([0.0; 3]),
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

/// Where a block keeps its unfinished contributions. Blocks take turns with a few desks, which stay in the fastest
/// cache that way.
#[derive(Default)]
pub(super) struct Desk<const N: usize> {
    pub entries: Vec<Entry<N>>,
    /// Slots of `entries` that no entry uses.
    pub free: Vec<u32>,
    /// Entries that wait for their turn to arrive, in its order, from the `next` on.
    waiting: Vec<Waiting>,
    next: usize,
    /// Entries that have arrived, in that order.
    pub open: Vec<Open>,
}

#[derive(Debug, Clone, Copy)]
pub(super) struct Waiting {
    /// Bits of the entry's least key, and its candidate's index.
    turn: u64,
    pub slot: u32,
    pub key_max: f32,
}

#[derive(Debug, Clone, Copy)]
pub(super) struct Open {
    pub slot: u32,
    /// Largest key.
    pub key_max: f32,
}

/// Least and largest key of an entry.
#[derive(Debug, Clone, Copy)]
pub(super) struct KeyRange {
    pub min: f32,
    pub max: f32,
}

impl KeyRange {
    /// Of an entry that contributes nothing.
    pub const EMPTY: Self = Self { min: f32::INFINITY, max: f32::NEG_INFINITY };

    pub fn is_empty(self) -> bool {
        self.min == f32::INFINITY
    }
}

impl<const N: usize> Desk<N> {
    /// A slot to make an entry in. Give it back with [`Desk::wait`] or [`Desk::release`].
    #[inline(always)]
    pub fn slot(&mut self) -> u32 {
        self.free.pop().unwrap_or_else(|| {
            self.entries.push(Entry::EMPTY);
            self.entries.len() as u32 - 1
        })
    }

    #[inline(always)]
    pub fn entry(&mut self, slot: u32) -> &mut Entry<N> {
        &mut self.entries[slot as usize]
    }

    /// Gives back a slot whose entry contributes nothing.
    #[inline(always)]
    pub fn release(&mut self, slot: u32) {
        self.free.push(slot);
    }

    /// Lets the entry in `slot` wait until nothing can arrive before its least key. Of equal keys, that of the lower
    /// `index` arrives first.
    #[inline(always)]
    pub fn wait(&mut self, slot: u32, keys: KeyRange, index: u32) {
        // Keys are not negative, so their bit patterns order as they do.
        let turn = u64::from(keys.min.to_bits()) << 32 | u64::from(index);
        let waiting = Waiting { turn, slot, key_max: keys.max };
        self.waiting.push(waiting);
        // Most come last, or nearly.
        let mut place = self.waiting.len() - 1;
        while place > self.next && self.waiting[place - 1].turn > turn {
            self.waiting[place] = self.waiting[place - 1];
            place -= 1;
        }
        self.waiting[place] = waiting;
    }

    pub fn is_empty(&self) -> bool {
        self.open.is_empty() && self.next == self.waiting.len()
    }

    /// Takes the entry whose turn is next if that is before `limit`.
    #[inline(always)]
    pub fn take_before(&mut self, limit: u64) -> Option<Waiting> {
        let first = self.waiting.get(self.next).copied().filter(|first| first.turn < limit)?;
        self.next += 1;
        Some(first)
    }

    /// The least key that waits.
    #[inline(always)]
    pub fn least_waiting(&mut self) -> f32 {
        // Those taken make room once they outnumber those that wait, so that each is moved at most once.
        if 2 * self.next >= self.waiting.len() {
            self.waiting.copy_within(self.next.., 0);
            self.waiting.truncate(self.waiting.len() - self.next);
            self.next = 0;
        }
        self.waiting.get(self.next).map_or(f32::INFINITY, |first| f32::from_bits((first.turn >> 32) as u32))
    }

    /// Makes every slot free again.
    pub fn clear(&mut self) {
        self.free.extend(self.waiting.drain(..).skip(self.next).map(|waiting| waiting.slot));
        self.next = 0;
        self.free.extend(self.open.drain(..).map(|open| open.slot));
    }
}
