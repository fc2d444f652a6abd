//! What a bake takes from earlier ones and leaves to later ones. A cache that cannot be written is a warning, once, and
//! never the end of a bake.

use std::sync::atomic::{AtomicBool, Ordering};

use bytemuck::cast_slice;
use serde::Serialize;

use super::workspace::Workspace;
use crate::bake::{BakeSettings, Cubemap, Earlier, ProbeStatistics, Progress, TileSums, Traced};
use crate::cache::{Bundle, Key, Store};
use crate::job::{Job, Surface};
use crate::scene::{Bounds, SplatEncoding};
use crate::shade::path::SurfaceNoise;
use crate::trace::{Footprint, TraceSettings};

/// Where a bake keeps its results.
pub(super) struct Memory<'a> {
    store: Option<Store>,
    /// Whether others use the store, so that it pays to keep what this bake itself has no more use for.
    is_shared: bool,
    workspace: &'a Workspace,
    progress: &'a dyn Progress,
    has_warned: AtomicBool,
}

/// Something in a scene that changes by itself: the Gaussians, or a mesh input.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub(super) struct Part {
    /// The hash of all that it is made of.
    pub key: Key,
    /// The box around it, in metres relative to the scene origin; `None` if it is empty.
    pub bounds: Option<Bounds>,
}

/// The parts of a scene as the tree has them: the Gaussians, and then the meshes.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub(super) struct Parts {
    pub splats: Part,
    pub meshes: Vec<Part>,
}

/// Where a probe was traced last.
#[derive(serde::Serialize, serde::Deserialize)]
struct Visit {
    parts: Parts,
    radiance: Key,
}

/// All that decides what the rays of a probe bring, but the scene's content.
pub(super) struct Site<'a> {
    pub job: &'a Job,
    pub settings: BakeSettings,
    pub rules: TraceSettings,
    pub encoding: SplatEncoding,
    /// World position of the scene origin, and the hash of the light around the scene.
    pub origin: glam::DVec3,
    pub background: Key,
    /// The hash of the whole scene.
    pub scene: Key,
    pub parts: &'a Parts,
}

impl<'a> Memory<'a> {
    /// The job's cache, the output folder's journal, or neither.
    pub fn new(job: &Job, workspace: &'a Workspace, progress: &'a dyn Progress) -> Self {
        let cache = job.cache.as_ref().map(Store::new);
        let is_shared = cache.is_some() && !job.no_cache;
        let store = if job.no_cache { None } else { cache.or_else(|| Some(workspace.journal().clone())) };
        Self { store, is_shared, workspace, progress, has_warned: AtomicBool::new(false) }
    }

    /// The store, if anything is kept.
    pub fn store(&self) -> Option<&Store> {
        self.store.as_ref()
    }

    /// Whether results are kept only until the bake is done.
    pub fn is_journal(&self) -> bool {
        self.store.is_some() && !self.is_shared
    }

    /// What is kept under `key`.
    pub fn get(&self, key: &Key) -> Option<Bundle> {
        Bundle::from_bytes(&self.store.as_ref()?.get(key)?)
    }

    /// Keeps `bundle` under `key`.
    pub fn put(&self, key: &Key, bundle: &Bundle) {
        let Some(store) = &self.store else { return };
        if let Err(error) = store.put(key, &bundle.to_bytes())
            && !self.has_warned.swap(true, Ordering::Relaxed)
        {
            self.progress.warn(&format!("{error}; results are not kept"));
        }
    }

    /// The files and the statistics of the probe with this key.
    pub fn probe(&self, key: &Key) -> Option<(Bundle, ProbeStatistics)> {
        let probe = self.get(key)?;
        Some((self.get(&probe.get_json("files")?)?, probe.get_json("statistics")?))
    }

    /// Remembers that the probe with this key has the files kept under `files`: from now on an interrupted bake has
    /// something to go on from.
    pub fn put_probe(&self, key: &Key, files: &Key, statistics: &ProbeStatistics) {
        let mut probe = Bundle::default();
        probe.add_json("files", files);
        probe.add_json("statistics", statistics);
        self.put(key, &probe);
        if self.is_journal() {
            self.workspace.set_resumable(true);
        }
    }

    /// Keeps what was traced for a probe at `position` (world), where others may want it.
    pub fn put_traced(&self, site: &Site, position: glam::DVec3, traced: &Traced, noise: Option<SurfaceNoise>) {
        if !self.is_shared {
            return;
        }
        let mut bundle = Bundle::default();
        bundle.add("texels", cast_slice(&traced.cubemap.texels).to_vec());
        if let Some(distance) = &traced.cubemap.distance {
            bundle.add("distance", cast_slice(distance).to_vec());
        }
        bundle.add("tiles", cast_slice(&traced.tiles).to_vec());
        bundle.add_json("noise", &noise);
        let radiance = site.radiance_key(position);
        self.put(&radiance, &bundle);
        let mut last = Bundle::default();
        last.add_json("visit", &Visit { parts: site.parts.clone(), radiance });
        self.put(&site.key(position), &last);
    }

    /// What is known of a probe at `position` (world) from tracing it before, in this scene or in one that differs by
    /// meshes alone, and the noise of its surfaces.
    pub fn earlier(&self, site: &Site, position: glam::DVec3) -> Option<(Earlier, Option<SurfaceNoise>)> {
        if !self.is_shared {
            return None;
        }
        let settings = &site.settings;
        if let Some((traced, noise)) = self.traced(&site.radiance_key(position), settings) {
            return Some((Earlier { kept: vec![true; traced.tiles.len()], traced }, noise));
        }
        let visit: Visit = self.get(&site.key(position))?.get_json("visit")?;
        let kept = site.tiles_that_see_no_change(&visit.parts, position)?;
        let (traced, noise) = self.traced(&visit.radiance, settings)?;
        Some((Earlier { traced, kept }, noise))
    }

    fn traced(&self, key: &Key, settings: &BakeSettings) -> Option<(Traced, Option<SurfaceNoise>)> {
        let bundle = self.get(key)?;
        let texels = values(bundle.get("texels")?)?;
        let distance = match bundle.get("distance") {
            Some(bytes) => Some(values(bytes)?),
            None => None,
        };
        let tiles: Vec<TileSums> = values(bundle.get("tiles")?)?;
        let cubemap = Cubemap { face_size: settings.face_size, texels, distance };
        Some((Traced { cubemap, tiles }, bundle.get_json("noise")?))
    }
}

/// Bytes as what they were; `None` if they are not a whole number of them.
fn values<T: bytemuck::AnyBitPattern>(bytes: &[u8]) -> Option<Vec<T>> {
    let size = size_of::<T>();
    bytes.len().is_multiple_of(size).then(|| bytes.chunks_exact(size).map(bytemuck::pod_read_unaligned).collect())
}

impl Site<'_> {
    /// The key of what was last traced from `position`, whatever was in the scene.
    fn key(&self, position: glam::DVec3) -> Key {
        #[derive(Serialize)]
        struct Depends<'a> {
            // The rules, as asked: what they become follows from them.
            footprint: crate::job::Footprint,
            order: crate::job::Order,
            sh_direction: crate::job::ShDirection,
            t_cutoff: f32,
            t_near: f32,
            surface: Surface,
            mesh_shadows: bool,
            noise: f32,
            max_paths: u32,
            tracer: crate::job::Tracer,
            calibration: bool,
            face_size: u32,
            samples: u32,
            distance: bool,
            edge_texels: bool,
            encoding: SplatEncoding,
            background: &'a Key,
            origin: glam::DVec3,
            position: glam::DVec3,
        }
        let Job { footprint, surface, mesh_shadows, noise, max_paths, tracer, calibration, .. } = *self.job;
        let TraceSettings { order, sh_direction, t_cutoff, t_near, .. } = self.rules;
        let BakeSettings { face_size, samples, distance, edge_texels } = self.settings;
        let depends = Depends {
            footprint,
            order,
            sh_direction,
            t_cutoff,
            t_near,
            surface,
            mesh_shadows,
            noise,
            max_paths,
            tracer,
            calibration,
            face_size,
            samples,
            distance,
            edge_texels,
            encoding: self.encoding,
            background: &self.background,
            origin: self.origin,
            position,
        };
        Key::of("site", &depends)
    }

    fn radiance_key(&self, position: glam::DVec3) -> Key {
        Key::of("radiance", &(self.key(position), self.scene))
    }

    /// Which tiles of a probe at `position` (world) see nothing that differs from the scene of `earlier`; `None` where all
    /// may.
    ///
    /// Unlit surfaces send the same light wherever else something moves, and a tile that meets no box of a changed part,
    /// as it was or as it is, takes the very same way through the tree ([`crate::bvh::Bvh::build`]): its bytes are the
    /// same. Light that is traced on from surfaces reaches all of the scene, and shadows on splats are seen beside the mesh.
    fn tiles_that_see_no_change(&self, earlier: &Parts, position: glam::DVec3) -> Option<Vec<bool>> {
        if self.job.surface != Surface::Unlit || self.job.mesh_shadows || earlier.splats != self.parts.splats {
            return None;
        }
        let changed = changed_boxes(&earlier.meshes, &self.parts.meshes)?;
        let origin = position - self.origin;
        let footprint: Footprint = self.rules.footprint;
        let is_kept = |tile: &crate::trace::Tile| !changed.iter().any(|bounds| tile.may_see(origin, bounds, footprint));
        Some(self.settings.tiles().iter().map(is_kept).collect())
    }
}

/// Boxes of the parts that only one of the lists has; `None` where those of both do not come in the same order, in which
/// hits at the same distance are blended.
fn changed_boxes(before: &[Part], now: &[Part]) -> Option<Vec<Bounds>> {
    let common = |list: &[Part], other: &[Part]| -> Vec<Key> {
        list.iter().map(|part| part.key).filter(|key| other.iter().any(|part| part.key == *key)).collect()
    };
    if common(before, now) != common(now, before) {
        return None;
    }
    let only_in = |list: &[Part], other: &[Part]| -> Vec<Bounds> {
        list.iter().filter(|part| !other.contains(part)).filter_map(|part| part.bounds).collect()
    };
    Some([only_in(before, now), only_in(now, before)].concat())
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;

    fn part(name: &str, at: f64) -> Part {
        let min = DVec3::splat(at);
        Part { key: Key::of("test", &name), bounds: Some(Bounds { min, max: min + 1.0 }) }
    }

    #[test]
    fn changed_boxes_are_where_a_part_was_and_where_it_is() {
        let (a, b, c) = (part("a", 0.0), part("b", 1.0), part("c", 2.0));
        let boxes = |parts: &[&Part]| Some(parts.iter().filter_map(|part| part.bounds).collect::<Vec<_>>());
        assert_eq!(changed_boxes(&[a.clone(), b.clone()], &[a.clone(), b.clone()]), boxes(&[]));
        let moved = part("moved", 5.0);
        assert_eq!(changed_boxes(&[a.clone(), b.clone()], &[moved.clone(), b.clone()]), boxes(&[&a, &moved]));
        assert_eq!(changed_boxes(&[a.clone(), b.clone()], &[a.clone(), c.clone(), b.clone()]), boxes(&[&c]));
        assert_eq!(changed_boxes(&[a.clone(), b.clone()], &[b.clone(), a.clone()]), None);
        assert_eq!(changed_boxes(&[a.clone(), a.clone()], std::slice::from_ref(&a)), None);
    }
}
