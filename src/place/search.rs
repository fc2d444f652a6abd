//! Which sites get a probe: insertion where prediction fails, removal where it does not.
//!
//! A site's error is that of the runtime's prediction there (`interpolate`) against what was traced there. The next probe
//! stands where it would save most of the errors above the target, by its own view of the sites that see it; that needs no
//! triangulation, and the triangulation then decides what has been won. Everything about a site depends on what it sees,
//! so that without a budget a change elsewhere changes nothing here; a budget is spent in the order of what a probe saves,
//! which is global by its nature.

use std::time::Instant;

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::free_space::Space;
use super::interpolate::Network;
use super::levels::Height;
use super::signal::{self, Signal};
use super::sites::LevelSites;
use super::triangulation::Share;
use super::walls::Traced;
use crate::trace::ray::RayScratch;

/// Error of a site that nothing predicts; predictions count as at most as bad.
const UNPREDICTED: f64 = 2.0;

/// A site is judged by the nearest so many that see it.
const NEAR: usize = 64;

/// A change that saves a smaller share of the errors is not worth making.
const LEAST_GAIN: f64 = 1e-3;

/// Every probe is offered its most promising other places, so many, ...
const TRIES: usize = 4;

/// ... at most so many times. Twice as many of both won less than one percent for twice the time.
const PASSES: usize = 4;

/// A place where a probe may stand, with what it would hold.
pub struct Candidate {
    /// Index of its level.
    pub level: usize,
    /// What a probe there holds.
    pub signal: Signal,
    /// What is seen there.
    pub truth: Vec<Vec3>,
}

/// Limits of a search.
#[derive(Debug, Clone, Copy)]
pub struct Budget {
    /// Relative error that no site needs to be below.
    pub error: f64,
    /// Most probes.
    pub probes: usize,
    /// When to stop.
    pub end: Option<Instant>,
}

/// A search's state: which sites have a probe, and what follows from it.
#[derive(Clone)]
pub struct Chosen {
    /// Indices of the candidates, in the order of insertion.
    pub probes: Vec<usize>,
    /// How they are blended; a probe's index is its candidate's.
    pub network: Network,
    /// Per candidate, the blend there.
    blends: Vec<Vec<Share>>,
    /// Per candidate, the error of that blend.
    pub errors: Vec<f64>,
}

/// Candidates and what they know of each other.
pub struct Search<'a> {
    levels: &'a [LevelSites],
    candidates: &'a [Candidate],
    budget: Budget,
    /// Per candidate: the sites near it that see it, with the error there if it alone were looked up.
    near: Vec<Vec<(usize, f64)>>,
    openings: Traced<'a>,
}

impl<'a> Search<'a> {
    /// Compares every candidate with those near it.
    pub fn new(space: &'a Space, levels: &'a [LevelSites], candidates: &'a [Candidate], budget: Budget) -> Self {
        let position = |i: usize| candidates[i].signal.position;
        let near = (0..candidates.len()).into_par_iter().map_init(RayScratch::default, |scratch, i| {
            let mut others: Vec<usize> = (0..candidates.len()).collect();
            others.sort_by_cached_key(|&j| position(i).distance_squared(position(j)).to_bits());
            // Those that do not see it count for nothing: what a wall hides must not take the place of what it does not.
            others.retain({
                let mut seen = 0;
                move |&j| {
                    let sees = seen < NEAR && space.is_open(position(i), position(j), scratch);
                    seen += usize::from(sees);
                    sees
                }
            });
            let error = |j: usize| {
                let view = candidates[i].signal.view(position(j));
                (j, signal::error(&view, &candidates[j].truth).min(UNPREDICTED))
            };
            others.into_iter().map(error).collect()
        });
        let near = near.collect();
        Self { levels, candidates, budget, near, openings: Traced::new(space) }
    }

    /// The whole search: insertion, removal, exchange.
    pub fn run(&self) -> Chosen {
        let probes = self.candidates.iter().map(|candidate| (candidate.signal.position, candidate.signal.proxy));
        let levels = self.levels.iter().map(|level| level.ground.with_probes(&[], &self.openings)).collect();
        let mut chosen = Chosen {
            probes: Vec::new(),
            network: Network { probes: probes.collect(), levels },
            blends: vec![Vec::new(); self.candidates.len()],
            errors: vec![UNPREDICTED; self.candidates.len()],
        };
        self.fill(&mut chosen);
        self.remove_predicted(&mut chosen);
        // What was taken out under a budget has made room.
        self.fill(&mut chosen);
        if chosen.probes.len() >= self.budget.probes {
            self.exchange(&mut chosen);
        }
        chosen
    }

    fn is_over(&self) -> bool {
        self.budget.end.is_some_and(|end| Instant::now() >= end)
    }

    /// What of an error is above the target.
    fn excess(&self, error: f64) -> f64 {
        (error - self.budget.error).max(0.0)
    }

    fn total_excess(&self, chosen: &Chosen) -> f64 {
        chosen.errors.iter().map(|&error| self.excess(error)).sum()
    }

    /// Inserts probes until no error is above the target or the budget is spent; one at least.
    fn fill(&self, chosen: &mut Chosen) {
        while chosen.probes.len() < self.budget.probes && (chosen.probes.is_empty() || !self.is_over()) {
            let Some(best) = self.best(chosen) else { return };
            self.change(chosen, None, Some(best));
        }
    }

    /// The candidate that would save most of the errors above the target; none where that is nothing. Of equals the first.
    fn best(&self, chosen: &Chosen) -> Option<usize> {
        self.promising(chosen, 1).first().copied()
    }

    /// The `count` candidates that promise to save most of the errors above the target, the best first.
    fn promising(&self, chosen: &Chosen, count: usize) -> Vec<usize> {
        let gain = |i: usize| -> f64 {
            if chosen.probes.contains(&i) {
                return 0.0;
            }
            let saved = |&(j, error): &(usize, f64)| (self.excess(chosen.errors[j]) - self.excess(error)).max(0.0);
            self.near[i].iter().map(saved).sum()
        };
        let gains: Vec<f64> = (0..self.candidates.len()).into_par_iter().map(gain).collect();
        let mut order: Vec<usize> = (0..gains.len()).filter(|&i| gains[i] > 0.0).collect();
        order.sort_by(|&a, &b| gains[b].total_cmp(&gains[a]).then(a.cmp(&b)));
        order.truncate(count);
        order
    }

    /// Takes out every probe without which no more error is above the target, the first inserted first.
    fn remove_predicted(&self, chosen: &mut Chosen) {
        for probe in chosen.probes.clone() {
            if chosen.probes.len() == 1 || self.is_over() {
                return;
            }
            let mut without = chosen.clone();
            self.change(&mut without, Some(probe), None);
            // Sums in another order differ in the last bits.
            if self.total_excess(&without) <= self.total_excess(chosen) + 1e-9 {
                *chosen = without;
            }
        }
    }

    /// Moves every probe to where it saves most by now, if that saves more, until none moves.
    fn exchange(&self, chosen: &mut Chosen) {
        for _ in 0..PASSES {
            let mut has_moved = false;
            for probe in chosen.probes.clone() {
                if self.is_over() {
                    return;
                }
                let mut without = chosen.clone();
                self.change(&mut without, Some(probe), None);
                let others = self.promising(&without, TRIES + 1).into_iter().filter(|&other| other != probe);
                let moved = others.take(TRIES).collect::<Vec<_>>().into_par_iter().map(|other| {
                    let mut moved = without.clone();
                    self.change(&mut moved, None, Some(other));
                    (self.total_excess(&moved), moved)
                });
                // Of equals the more promising.
                let best = moved
                    .collect::<Vec<_>>()
                    .into_iter()
                    .reduce(|best, next| if next.0 < best.0 { next } else { best });
                if let Some((excess, moved)) = best
                    && excess < self.total_excess(chosen) * (1.0 - LEAST_GAIN)
                {
                    *chosen = moved;
                    has_moved = true;
                }
            }
            if !has_moved {
                return;
            }
        }
    }

    /// Removes and adds a probe, triangulates all levels of their storeys anew, and judges the sites whose blend that changes.
    fn change(&self, chosen: &mut Chosen, remove: Option<usize>, add: Option<usize>) {
        chosen.probes.retain(|&probe| Some(probe) != remove);
        chosen.probes.extend(add);
        let storeys: Vec<Height> = [remove, add].into_iter().flatten().map(|i| self.height_of(i)).collect();
        let (network, probes) = (&mut chosen.network, &chosen.probes);
        network.levels.par_iter_mut().zip(self.levels).for_each(|(level, LevelSites { height, ground, .. })| {
            if storeys.iter().any(|storey| storey.is_same_storey(height)) {
                let own = probes.iter().filter(|&&probe| self.height_of(probe).is_same_storey(height));
                let mut own: Vec<(u32, DVec3)> = own.map(|&i| (i as u32, self.candidates[i].signal.position)).collect();
                // Whatever the order of insertion was.
                own.sort_unstable_by_key(|(probe, _)| *probe);
                *level = ground.with_probes(&own, &self.openings);
            }
        });
        let Chosen { network, blends, errors, .. } = chosen;
        let sites = blends.par_iter_mut().zip(errors).zip(self.candidates);
        sites.for_each(|((blend, error), site)| {
            let now = network.weights(site.signal.position);
            if now != *blend {
                *blend = now;
                *error = self.error(blend, site);
            }
        });
    }

    fn error(&self, blend: &[Share], site: &Candidate) -> f64 {
        let mut sum = vec![Vec3::ZERO; site.truth.len()];
        for share in blend {
            let view = self.candidates[share.probe as usize].signal.view(site.signal.position);
            sum.iter_mut().zip(view).for_each(|(sum, value)| *sum += value * share.weight as f32);
        }
        if blend.is_empty() { UNPREDICTED } else { signal::error(&sum, &site.truth).min(UNPREDICTED) }
    }

    fn height_of(&self, candidate: usize) -> Height {
        self.levels[self.candidates[candidate].level].height
    }
}
