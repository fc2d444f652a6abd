//! Which core traces what, and when.
//!
//! The unit of work is a tile of at most [`Tile::EDGE`] rays squared. All tiles of a batch of probes are one parallel
//! iteration, so that one probe with large faces and a thousand with small ones both keep every core busy. A batch is
//! bounded in memory and in tiles, and while it is traced the batch before it is delivered. Every texel belongs to one tile and
//! sums are formed in tile order, so nothing depends on the number of threads.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::traced::{Earlier, TileSums, Traced};
use super::{BakeSettings, Cubemap, ProbeStatistics, Progress};
use crate::error::{Error, Result};
use crate::place::Probe;
use crate::scene::Scene;
use crate::trace::{Face, Radiance, Tile, TileTracer};

/// Tiles in a batch per thread, about: enough for all to be busy, few enough that little is lost with a bake that is killed.
const TILES_PER_THREAD: usize = 32;

/// Most bytes of cubemaps in a batch; two batches are held at a time. A probe that alone is larger is its own batch.
const BATCH_BYTES: usize = 256 << 20;

/// Bakes the cubemaps of all probes and hands each to `sink`, with the probe's index in `probes`.
///
/// Cubemaps reach `sink` on several threads at once and in no certain order; their content depends on neither. Setting
/// `cancel` ends the bake within about a tile's time.
///
/// Fails with [`Error::Request`] when a setting is out of range, [`Error::Cancelled`] when `cancel` is set, or the first
/// error of `sink`; no further probes are delivered then, except those already under way.
pub fn bake_probes(
    tracer: &dyn TileTracer,
    scene: &Scene,
    probes: &[Probe],
    settings: &BakeSettings,
    progress: &dyn Progress,
    cancel: &AtomicBool,
    sink: impl Fn(usize, Cubemap, ProbeStatistics) -> Result<()> + Sync,
) -> Result<()> {
    progress.begin(probes.len(), probes.len() as u64 * settings.rays_per_probe());
    let sink = |index, traced: Traced| {
        let statistics = traced.statistics(settings);
        sink(index, traced.cubemap, statistics)
    };
    let result = rebake_probes(tracer, scene, probes, settings, progress, cancel, &|_| None, sink);
    progress.finish();
    result.map(drop)
}

/// As [`bake_probes`], but keeps the tiles that `earlier` gives for a probe, by its index in `probes`. What does not fit
/// `settings` is as if it were not given. Returns how many rays were traced; `progress` hears of those and of what is kept.
#[expect(clippy::too_many_arguments)]
pub fn rebake_probes(
    tracer: &dyn TileTracer,
    scene: &Scene,
    probes: &[Probe],
    settings: &BakeSettings,
    progress: &dyn Progress,
    cancel: &AtomicBool,
    earlier: &(dyn Fn(usize) -> Option<Earlier> + Sync),
    sink: impl Fn(usize, Traced) -> Result<()> + Sync,
) -> Result<u64> {
    settings.check()?;
    let (failed, rays) = (AtomicBool::new(false), AtomicU64::new(0));
    let bake = Bake { tracer, scene, settings, progress, cancel, earlier, failed: &failed, rays: &rays, sink: &sink };
    bake.run(probes, BATCH_BYTES)?;
    Ok(rays.into_inner())
}

/// What stays the same throughout a bake.
struct Bake<'a, Sink> {
    tracer: &'a dyn TileTracer,
    scene: &'a Scene,
    settings: &'a BakeSettings,
    progress: &'a dyn Progress,
    cancel: &'a AtomicBool,
    earlier: &'a (dyn Fn(usize) -> Option<Earlier> + Sync),
    failed: &'a AtomicBool,
    rays: &'a AtomicU64,
    sink: &'a Sink,
}

impl<Sink: Fn(usize, Traced) -> Result<()> + Sync> Bake<'_, Sink> {
    fn run(&self, probes: &[Probe], batch_bytes: usize) -> Result<()> {
        let batch_len = self.settings.batch_len(batch_bytes);
        let mut before = Vec::new();
        for (number, batch) in probes.chunks(batch_len).enumerate() {
            let (delivered, traced) =
                rayon::join(|| self.deliver(before), || self.trace_batch(number * batch_len, batch));
            // In this order: a failed delivery is why tracing stopped.
            delivered?;
            before = traced?;
        }
        self.deliver(before)
    }

    fn deliver(&self, batch: Vec<(usize, Traced)>) -> Result<()> {
        batch.into_par_iter().with_max_len(1).try_for_each(|(index, traced)| {
            if self.failed.load(Ordering::Relaxed) {
                // Another delivery's error is on its way to the caller; a second one must not overtake it.
                return Ok(());
            }
            self.check_stopped()?;
            (self.sink)(index, traced).inspect_err(|_| self.failed.store(true, Ordering::Relaxed))?;
            self.progress.probe_done(index);
            Ok(())
        })
    }

    fn trace_batch(&self, first: usize, probes: &[Probe]) -> Result<Vec<(usize, Traced)>> {
        let (mut cubemaps, kept): (Vec<Cubemap>, Vec<Vec<Option<TileSums>>>) =
            (first..first + probes.len()).into_par_iter().map(|index| self.before(index)).unzip();
        let origins = probes.iter().map(|probe| probe.position - self.scene.origin);
        let tasks: Vec<Task> = cubemaps
            .iter_mut()
            .zip(origins)
            .zip(kept)
            .flat_map(|((cubemap, origin), kept)| tasks(cubemap, origin, self.settings, kept))
            .collect();
        let tasks_per_probe = tasks.len() / probes.len();
        let sums: Vec<TileSums> =
            tasks.into_par_iter().with_max_len(1).map(|task| self.trace(task)).collect::<Result<_>>()?;
        let tiles = sums.chunks(tasks_per_probe).map(<[TileSums]>::to_vec);
        Ok((first..).zip(cubemaps.into_iter().zip(tiles).map(|(cubemap, tiles)| Traced { cubemap, tiles })).collect())
    }

    /// What a probe's tiles are before they are traced, and the sums over those that stay so.
    fn before(&self, index: usize) -> (Cubemap, Vec<Option<TileSums>>) {
        match (self.earlier)(index).filter(|earlier| earlier.fits(self.settings)) {
            Some(Earlier { traced, kept }) => {
                let kept = kept.into_iter().zip(traced.tiles).map(|(kept, sums)| kept.then_some(sums)).collect();
                (traced.cubemap, kept)
            }
            None => (Cubemap::empty(self.settings), vec![None; self.settings.tiles().len()]),
        }
    }

    /// Traces a tile and writes the means of its rays to its texels, unless it is kept.
    fn trace(&self, mut task: Task) -> Result<TileSums> {
        self.check_stopped()?;
        if let Some(sums) = task.kept {
            self.progress.advance(task.tile.len() as u64);
            return Ok(sums);
        }
        let mut rays = vec![Radiance::default(); task.tile.len()];
        self.tracer.trace_tile(task.origin, &task.tile, &mut rays);
        let samples = self.settings.samples as usize;
        let ray_columns = task.tile.width as usize;
        let mut sums = TileSums::default();
        for (y, row) in task.rows.iter_mut().enumerate() {
            for (x, texel) in row.iter_mut().enumerate() {
                let first_ray = y * samples * ray_columns + x * samples;
                let block = (0..samples * samples).map(|k| first_ray + k / samples * ray_columns + k % samples);
                let (rgba, distance) = self.mean(&task.tile, &rays, block);
                *texel = rgba;
                sums.add(rgba[3], distance);
                if let Some(row) = task.distance_rows.get_mut(y) {
                    row[x] = distance;
                }
            }
        }
        self.progress.advance(task.tile.len() as u64);
        self.rays.fetch_add(task.tile.len() as u64, Ordering::Relaxed);
        Ok(sums)
    }

    /// Mean linear RGB and coverage of a texel's rays, and their mean distance weighted by coverage.
    /// `block` are their places in the tile's `rays`.
    fn mean(&self, tile: &Tile, rays: &[Radiance], block: impl Iterator<Item = usize>) -> ([f32; 4], f32) {
        let (mut rgb, mut coverage, mut distance_sum) = (Vec3::ZERO, 0.0, 0.0);
        for place in block {
            let ray = &rays[place];
            let background = if self.scene.environment.is_some() && ray.transmittance > 0.0 {
                let (x, y) = (place as u32 % tile.width, place as u32 / tile.width);
                self.scene.background_along(tile.direction(x, y))
            } else {
                self.scene.background
            };
            rgb += ray.to_linear(self.scene.encoding, background).0;
            coverage += ray.coverage();
            distance_sum += ray.distance_sum;
        }
        let count = self.settings.samples.pow(2) as f32;
        let distance = if coverage > 0.0 { distance_sum / coverage } else { 0.0 };
        ((rgb / count).extend(coverage / count).to_array(), distance)
    }

    fn check_stopped(&self) -> Result<()> {
        let stopped = self.cancel.load(Ordering::Relaxed) || self.failed.load(Ordering::Relaxed);
        if stopped { Err(Error::Cancelled) } else { Ok(()) }
    }
}

/// A tile of rays and the texels that they become.
struct Task<'a> {
    origin: DVec3,
    tile: Tile,
    /// Sums over the texels where they are as they should be already.
    kept: Option<TileSums>,
    rows: Vec<&'a mut [[f32; 4]]>,
    /// Empty when distances are not kept.
    distance_rows: Vec<&'a mut [f32]>,
}

impl BakeSettings {
    /// The tiles of rays that a probe is traced in, face by face, row by row: each is traced by itself.
    pub fn tiles(&self) -> Vec<Tile> {
        let (face_size, samples) = (self.face_size, self.samples);
        // A texel on an edge has half of its rays beyond it.
        let (face_rays, beyond) =
            if self.edge_texels { ((face_size - 1) * samples, samples / 2) } else { (face_size * samples, 0) };
        let first_ray = |texel: u32| (texel * samples) as i32 - beyond as i32;
        let rays = |start: u32| self.tile_texels().min(face_size - start) * samples;
        let starts = || (0..face_size).step_by(self.tile_texels() as usize);
        let tile = |face, x, y| Tile {
            face,
            face_size: face_rays,
            x: first_ray(x),
            y: first_ray(y),
            width: rays(x),
            height: rays(y),
        };
        let places =
            Face::ALL.into_iter().flat_map(|face| starts().flat_map(move |y| starts().map(move |x| (face, x, y))));
        places.map(|(face, x, y)| tile(face, x, y)).collect()
    }

    /// How many probes are traced together, by the threads that are there.
    pub fn probes_at_a_time(&self) -> usize {
        self.batch_len(BATCH_BYTES)
    }

    fn batch_len(&self, batch_bytes: usize) -> usize {
        let texel_bytes = if self.distance { 20 } else { 16 };
        let probe_bytes = 6 * (self.face_size as usize).pow(2) * texel_bytes;
        let tiles = rayon::current_num_threads() * TILES_PER_THREAD;
        (batch_bytes / probe_bytes).min(tiles.div_ceil(self.tiles().len())).max(1)
    }

    /// Texels along an edge of a tile.
    fn tile_texels(&self) -> u32 {
        Tile::EDGE / self.samples
    }
}

/// Cuts a cubemap into tiles that can be written independently; `kept` has one element for each. `origin` is the probe's,
/// relative to the scene's.
fn tasks<'a>(
    cubemap: &'a mut Cubemap,
    origin: DVec3,
    settings: &BakeSettings,
    kept: Vec<Option<TileSums>>,
) -> Vec<Task<'a>> {
    let tiles = settings.tiles().into_iter().zip(kept);
    let mut tasks: Vec<Task> =
        tiles.map(|(tile, kept)| Task { origin, tile, kept, rows: Vec::new(), distance_rows: Vec::new() }).collect();
    let (face_size, tile_texels) = (settings.face_size as usize, settings.tile_texels() as usize);
    let tiles_per_row = face_size.div_ceil(tile_texels);
    // The first of the tiles that a row of the whole cubemap passes through.
    let first_tile = |row: usize| (row / face_size * tiles_per_row + row % face_size / tile_texels) * tiles_per_row;
    for (y, row) in cubemap.texels.chunks_exact_mut(face_size).enumerate() {
        for (task, piece) in tasks[first_tile(y)..].iter_mut().zip(row.chunks_mut(tile_texels)) {
            task.rows.push(piece);
        }
    }
    for (y, row) in cubemap.distance.iter_mut().flat_map(|distance| distance.chunks_exact_mut(face_size)).enumerate() {
        for (task, piece) in tasks[first_tile(y)..].iter_mut().zip(row.chunks_mut(tile_texels)) {
            task.distance_rows.push(piece);
        }
    }
    tasks
}

#[cfg(test)]
mod tests {
    use std::sync::Mutex;
    use std::sync::atomic::{AtomicU64, AtomicUsize};

    use super::*;
    use crate::bake::Silent;
    use crate::scene::Bounds;
    use crate::scene::LinearRgb;

    /// Half-covered everywhere; colour is the probe's position plus the (not normalised) direction, which is linear
    /// over a face, so that any mean over a texel is its centre's value. Distance is 2 on +X and 6 elsewhere.
    struct DirectionColours;

    impl TileTracer for DirectionColours {
        fn trace_tile(&self, origin: DVec3, tile: &Tile, texels: &mut [Radiance]) {
            assert!(tile.width <= Tile::EDGE && tile.height <= Tile::EDGE);
            for (i, texel) in texels.iter_mut().enumerate() {
                let (x, y) = (tile.x as u32 + i as u32 % tile.width, tile.y as u32 + i as u32 / tile.width);
                let direction = tile.face.direction(tile.face_size, f64::from(x) + 0.5, f64::from(y) + 0.5);
                let distance = if tile.face == Face::PosX { 2.0 } else { 6.0 };
                *texel = Radiance {
                    surface_sum: (origin + direction).as_vec3(),
                    distance_sum: 0.5 * distance,
                    transmittance: 0.5,
                    ..Radiance::default()
                };
            }
        }
    }

    fn probes(count: usize) -> Vec<Probe> {
        let probe = |i: usize| Probe {
            id: format!("probe_{i:03}"),
            position: DVec3::new(100.0 + i as f64, 0.0, 0.0),
            influence: Bounds { min: DVec3::ZERO, max: DVec3::ONE },
            proxy: Bounds { min: DVec3::ZERO, max: DVec3::ONE },
            blend: [0.0; 6],
        };
        (0..count).map(probe).collect()
    }

    /// A scene with an origin of (100, 0, 0) and a background of `background` in all channels.
    fn scene(background: f32) -> Scene {
        Scene { origin: DVec3::X * 100.0, background: LinearRgb(Vec3::splat(background)), ..Scene::default() }
    }

    fn bake(
        count: usize,
        settings: BakeSettings,
        threads: usize,
        batch_bytes: usize,
    ) -> Vec<(usize, Cubemap, ProbeStatistics)> {
        let delivered = Mutex::new(Vec::new());
        let sink = |index, traced: Traced| {
            let statistics = traced.statistics(&settings);
            delivered.lock().unwrap().push((index, traced.cubemap, statistics));
            Ok(())
        };
        let (cancel, failed, rays) = (AtomicBool::new(false), AtomicBool::new(false), AtomicU64::new(0));
        let bake = Bake {
            tracer: &DirectionColours,
            scene: &scene(0.0),
            settings: &settings,
            progress: &Silent,
            cancel: &cancel,
            earlier: &|_| None,
            failed: &failed,
            rays: &rays,
            sink: &sink,
        };
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| bake.run(&probes(count), batch_bytes)).unwrap();
        let mut delivered = delivered.into_inner().unwrap();
        delivered.sort_by_key(|(index, ..)| *index);
        delivered
    }

    #[test]
    fn every_texel_is_the_ray_through_its_centre_whatever_the_samples() {
        for (face_size, samples) in [(1, 1), (70, 1), (128, 1), (33, 2), (20, 4), (3, 64)] {
            let settings = BakeSettings { face_size, samples, distance: true, edge_texels: false };
            for (index, cubemap, statistics) in bake(2, settings, 2, BATCH_BYTES) {
                assert_eq!(statistics.rays, 6 * u64::from(face_size * samples).pow(2));
                for face in Face::ALL {
                    for (i, texel) in cubemap.face(face).iter().enumerate() {
                        let (x, y) = (i as u32 % face_size, i as u32 / face_size);
                        let centre = face.direction(face_size, f64::from(x) + 0.5, f64::from(y) + 0.5);
                        let expected = (centre + DVec3::X * index as f64).as_vec3();
                        let difference = (Vec3::from_slice(&texel[..3]) - expected).abs().max_element();
                        let tolerance = if samples == 1 { 0.0 } else { 1e-5 };
                        assert!(difference <= tolerance, "{face_size}x{samples} {face:?} {x},{y}: {texel:?}");
                        assert_eq!(texel[3], 0.5);
                    }
                }
            }
        }
    }

    #[test]
    fn neither_threads_nor_batches_change_a_byte() {
        let settings = BakeSettings { face_size: 70, samples: 2, distance: true, edge_texels: false };
        let one = bake(5, settings, 1, BATCH_BYTES);
        assert_eq!(one.len(), 5);
        assert!(one == bake(5, settings, 2, BATCH_BYTES));
        assert!(one == bake(5, settings, 4, 2 * 6 * 70 * 70 * 20));
        assert!(one == bake(5, settings, 2, 1));
    }

    #[test]
    fn kept_tiles_are_not_traced_and_the_others_are() {
        let settings = BakeSettings { face_size: 70, samples: 2, distance: true, edge_texels: false };
        let delivered = Mutex::new(Vec::new());
        let sink = |_, traced| {
            delivered.lock().unwrap().push(traced);
            Ok(())
        };
        let cancel = AtomicBool::new(false);
        let again = |earlier: Option<Earlier>| {
            let (scene, earlier) = (scene(0.0), |_| earlier.clone());
            let probes = probes(1);
            let rays =
                rebake_probes(&DirectionColours, &scene, &probes, &settings, &Silent, &cancel, &earlier, sink).unwrap();
            (rays, delivered.lock().unwrap().pop().unwrap())
        };
        let (rays, whole) = again(None);
        assert_eq!(rays, settings.rays_per_probe());
        let mut earlier = Earlier { traced: whole.clone(), kept: vec![true; settings.tiles().len()] };
        // What is not kept is wrong, and a kept tile shows that it was not looked at.
        earlier.kept[3] = false;
        let tile = settings.tiles()[3];
        let (x, y) = (tile.x as usize / 2, tile.y as usize / 2);
        earlier.traced.cubemap.texels[y * 70 + x] = [9.0; 4];
        earlier.traced.tiles[3] = TileSums::default();
        assert_eq!(again(Some(earlier.clone())), (tile.len() as u64, whole.clone()));
        earlier.traced.cubemap.texels[0] = [9.0; 4];
        assert_eq!(again(Some(earlier.clone())).1.cubemap.texels[0], [9.0; 4]);
        // Of another size it is nothing.
        earlier.kept.pop();
        assert_eq!(again(Some(earlier)), (rays, whole));
    }

    #[test]
    fn statistics_weigh_distances_by_coverage() {
        let settings = BakeSettings { face_size: 65, samples: 1, distance: false, edge_texels: false };
        let (_, cubemap, statistics) = bake(1, settings, 2, BATCH_BYTES).remove(0);
        assert_eq!(cubemap.distance, None);
        assert_eq!(statistics.mean_coverage, 0.5);
        let distance = statistics.distance.unwrap();
        assert_eq!((distance.min, distance.max), (2.0, 6.0));
        assert!((distance.mean - (2.0 + 5.0 * 6.0) / 6.0).abs() < 1e-9);
    }

    /// Sees nothing through odd ray columns, and a wall at 3 m through even ones.
    struct Fence;

    impl TileTracer for Fence {
        fn trace_tile(&self, _origin: DVec3, tile: &Tile, texels: &mut [Radiance]) {
            for (i, texel) in texels.iter_mut().enumerate() {
                let x = tile.x as u32 + i as u32 % tile.width;
                let wall = Radiance { distance_sum: 3.0, transmittance: 0.0, ..Radiance::default() };
                *texel = if x.is_multiple_of(2) { wall } else { Radiance::default() };
            }
        }
    }

    #[test]
    fn rays_that_escape_bring_the_background_and_do_not_change_the_distance() {
        let settings = BakeSettings { face_size: 3, samples: 2, distance: true, edge_texels: false };
        let sink = |_, cubemap: Cubemap, statistics: ProbeStatistics| {
            assert!(cubemap.texels.iter().all(|texel| *texel == [0.25, 0.25, 0.25, 0.5]), "{:?}", cubemap.texels);
            assert!(cubemap.distance.unwrap().iter().all(|distance| *distance == 3.0));
            assert_eq!(statistics.mean_coverage, 0.5);
            Ok(())
        };
        let cancel = AtomicBool::new(false);
        bake_probes(&Fence, &scene(0.5), &probes(1), &settings, &Silent, &cancel, sink).unwrap();
    }

    #[derive(Default)]
    struct Count {
        rays: AtomicU64,
        probes: AtomicUsize,
        finished: AtomicUsize,
    }

    impl Progress for Count {
        fn begin(&self, probes: usize, rays: u64) {
            assert_eq!((probes, rays), (3, 3 * 6 * 64));
        }

        fn advance(&self, rays: u64) {
            self.rays.fetch_add(rays, Ordering::Relaxed);
        }

        fn probe_done(&self, _index: usize) {
            self.probes.fetch_add(1, Ordering::Relaxed);
        }

        fn finish(&self) {
            self.finished.fetch_add(1, Ordering::Relaxed);
        }
    }

    #[test]
    fn progress_hears_of_every_ray_and_every_probe() {
        let settings = BakeSettings { face_size: 8, samples: 1, distance: false, edge_texels: false };
        let (progress, cancel) = (Count::default(), AtomicBool::new(false));
        let sink = |_, _, _| Ok(());
        bake_probes(&DirectionColours, &scene(0.0), &probes(3), &settings, &progress, &cancel, sink).unwrap();
        assert_eq!(progress.rays.into_inner(), 3 * 6 * 64);
        assert_eq!(progress.probes.into_inner(), 3);
        assert_eq!(progress.finished.into_inner(), 1);
    }

    #[test]
    fn a_cancelled_bake_delivers_nothing_and_says_so() {
        let settings = BakeSettings { face_size: 8, samples: 1, distance: false, edge_texels: false };
        let (progress, cancel) = (Count::default(), AtomicBool::new(true));
        let sink = |_, _, _| panic!("delivered a probe");
        let result = bake_probes(&DirectionColours, &scene(0.0), &probes(3), &settings, &progress, &cancel, sink);
        assert!(matches!(result, Err(Error::Cancelled)), "{result:?}");
        assert_eq!(progress.finished.into_inner(), 1);
    }

    #[test]
    fn the_error_of_the_sink_is_the_error_of_the_bake() {
        let settings = BakeSettings { face_size: 8, samples: 1, distance: false, edge_texels: false };
        let sink = |_, _, _| Err(Error::write("full/disk", std::io::ErrorKind::StorageFull.into()));
        let cancel = AtomicBool::new(false);
        let result = bake_probes(&DirectionColours, &scene(0.0), &probes(3), &settings, &Silent, &cancel, sink);
        assert!(matches!(result, Err(Error::Write { .. })), "{result:?}");
    }

    #[test]
    fn settings_out_of_range_name_the_setting() {
        let cancel = AtomicBool::new(false);
        for (face_size, samples, wrong) in
            [(0, 1, "face-size"), (8193, 1, "face-size"), (8, 0, "samples"), (8, 65, "samples")]
        {
            let settings = BakeSettings { face_size, samples, distance: false, edge_texels: false };
            let sink = |_, _, _| Ok(());
            let result = bake_probes(&DirectionColours, &scene(0.0), &probes(3), &settings, &Silent, &cancel, sink);
            assert!(matches!(result, Err(Error::Request { field, .. }) if field == wrong));
        }
    }
}
