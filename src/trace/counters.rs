//! What the beam tracer did, counted while it works: where time goes, and what was skipped.

use std::sync::atomic::{AtomicU64, Ordering};

use serde::Serialize;

/// Sums over everything that is traced with it, on all threads.
#[derive(Debug)]
pub struct Counters {
    tiles: AtomicU64,
    rays: AtomicU64,
    nodes: AtomicU64,
    candidates: AtomicU64,
    evaluations: AtomicU64,
    contributions: AtomicU64,
    fallback_rays: AtomicU64,
    /// A bit per Gaussian.
    touched: Vec<AtomicU64>,
    gaussians: usize,
}

/// What one tile adds.
#[derive(Debug, Default, Clone, Copy, PartialEq, Eq)]
pub(super) struct Tally {
    pub nodes: u64,
    pub candidates: u64,
    pub evaluations: u64,
    pub contributions: u64,
    pub fallback_rays: u64,
}

impl std::ops::AddAssign for Tally {
    fn add_assign(&mut self, other: Self) {
        self.nodes += other.nodes;
        self.candidates += other.candidates;
        self.evaluations += other.evaluations;
        self.contributions += other.contributions;
        self.fallback_rays += other.fallback_rays;
    }
}

impl Counters {
    /// Counters for a scene of so many Gaussians, all zero.
    pub fn new(gaussians: usize) -> Self {
        Self {
            tiles: AtomicU64::new(0),
            rays: AtomicU64::new(0),
            nodes: AtomicU64::new(0),
            candidates: AtomicU64::new(0),
            evaluations: AtomicU64::new(0),
            contributions: AtomicU64::new(0),
            fallback_rays: AtomicU64::new(0),
            touched: (0..gaussians.div_ceil(64)).map(|_| AtomicU64::new(0)).collect(),
            gaussians,
        }
    }

    pub(super) fn add_tile(&self, rays: usize, tally: Tally) {
        let add = |sum: &AtomicU64, value: u64| sum.fetch_add(value, Ordering::Relaxed);
        add(&self.tiles, 1);
        add(&self.rays, rays as u64);
        add(&self.nodes, tally.nodes);
        add(&self.candidates, tally.candidates);
        add(&self.evaluations, tally.evaluations);
        add(&self.contributions, tally.contributions);
        add(&self.fallback_rays, tally.fallback_rays);
    }

    pub(super) fn touch(&self, gaussian: u32) {
        let (word, bit) = (&self.touched[gaussian as usize / 64], 1 << (gaussian % 64));
        // Most have been touched before; reading leaves the cache line shared between cores.
        if word.load(Ordering::Relaxed) & bit == 0 {
            word.fetch_or(bit, Ordering::Relaxed);
        }
    }

    /// The counts so far, as ratios.
    pub fn report(&self) -> CounterReport {
        let count = |sum: &AtomicU64| sum.load(Ordering::Relaxed);
        let per = |sum: &AtomicU64, units: &AtomicU64| count(sum) as f64 / count(units).max(1) as f64;
        CounterReport {
            tiles: count(&self.tiles),
            rays: count(&self.rays),
            nodes_per_tile: per(&self.nodes, &self.tiles),
            candidates_per_tile: per(&self.candidates, &self.tiles),
            evaluations_per_ray: per(&self.evaluations, &self.rays),
            contributions_per_ray: per(&self.contributions, &self.rays),
            lanes_used: per(&self.contributions, &self.evaluations),
            gaussians: self.gaussians,
            gaussians_touched: self.touched.iter().map(|word| count(word).count_ones() as usize).sum(),
            fallback_rays: count(&self.fallback_rays),
        }
    }
}

/// What [`Counters`] counted.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[serde(rename_all = "camelCase")]
pub struct CounterReport {
    /// Pieces of faces, of at most 64 x 64 texels, each of which went through the tree by itself.
    pub tiles: u64,
    /// Rays traced.
    pub rays: u64,
    /// Nodes opened.
    pub nodes_per_tile: f64,
    /// Gaussians and triangles that a tile shaded. Gaussians count again where a window ends between two chunks.
    pub candidates_per_tile: f64,
    /// Responses computed, those of idle lanes included.
    pub evaluations_per_ray: f64,
    /// Responses of at least 1/255 where they still counted.
    pub contributions_per_ray: f64,
    /// Share of evaluations that contributed.
    pub lanes_used: f64,
    /// Gaussians in the scene.
    pub gaussians: usize,
    /// Gaussians that any tile shaded. The colours of the others were never evaluated.
    pub gaussians_touched: usize,
    /// Rays whose order could not be settled in their block and that went to the ray tracer.
    pub fallback_rays: u64,
}
