//! The one place where a job's values are checked, alone and together.

use super::footprint::MIN_FOCAL;
use super::{Background, Crop, Footprint, Job, MeshInput, OutputKind, Placement, SplatInput, Transform};
use crate::{Error, Result};

/// Largest edge of a cube face, in pixels: a probe's six faces then take 6 GiB while they are traced.
pub const MAX_FACE_SIZE: u32 = 8192;

/// Largest number of rays per pixel and axis.
pub const MAX_SAMPLES: u32 = 64;

/// Most mips of a chain: those of the largest face.
pub const MAX_MIPS: u32 = MAX_FACE_SIZE.ilog2() + 1;

/// Largest exposure in stops, either way: more leaves the range of half floats.
const MAX_EXPOSURE: f32 = 32.0;

/// Largest radiance of expanded highlights: what half floats hold.
const MAX_EXPANSION: f32 = 65504.0;

/// Most paths per ray that meets a surface.
pub const MAX_PATHS: u32 = 1 << 20;

/// Most probes of one bake; each is a folder.
pub const MAX_PROBES: usize = 1_000_000;

/// Most rays of one bake: a day and a half at 8 million a second. More is a slip of the finger.
const MAX_RAYS: u128 = 1_000_000_000_000;

/// Coordinates beyond this, in metres, are not a scene on or near the Earth.
const MAX_COORDINATE: f64 = 1e9;

/// Most heights of probes that can be asked for.
const MAX_LEVELS: usize = 64;

/// Longest time that can be asked for, in seconds: a month.
const MAX_TIME: f64 = 2.6e6;

/// Most positions that a placement's error is measured at; each costs as much as a place for a probe.
const MAX_HELD_OUT: u32 = 10_000;

/// More threads than any machine in reach has cores.
const MAX_THREADS: usize = 1024;

impl Job {
    /// Checks every setting, alone and together. The first fault is the error, named by its flag, with what would be
    /// right. Files are not touched.
    pub fn validate(&self) -> Result<()> {
        require(self.calibration || !self.splats.is_empty() || !self.meshes.is_empty(), "--splats", || {
            "nothing to bake: give at least one splat or mesh file".into()
        })?;
        self.splats.iter().try_for_each(SplatInput::validate)?;
        self.meshes.iter().try_for_each(MeshInput::validate)?;
        require(self.output.is_some(), "-o", || "give the folder to write the probes to".into())?;
        self.placement.validate()?;
        require((1..=MAX_FACE_SIZE).contains(&self.face_size), "--face-size", || {
            format!("{} is not between 1 and {MAX_FACE_SIZE} pixels", self.face_size)
        })?;
        require((1..=MAX_SAMPLES).contains(&self.samples), "--samples", || {
            format!("{} is not between 1 and {MAX_SAMPLES} rays per pixel and axis", self.samples)
        })?;
        if let Footprint::Train(focal) = self.footprint {
            require(focal.is_finite() && focal >= MIN_FOCAL, "--footprint", || {
                format!("{focal} is not a focal length of {MIN_FOCAL} pixel or more")
            })?;
        }
        require((0.0..1.0).contains(&self.t_cutoff), "--t-cutoff", || {
            format!("{} is not a transmittance from 0 to below 1", self.t_cutoff)
        })?;
        require(self.t_near.is_finite() && self.t_near >= 0.0, "--t-near", || {
            format!("{} is not a distance in metres, 0 or more", self.t_near)
        })?;
        require(self.noise.is_finite() && self.noise >= 0.0, "--noise", || {
            format!("{} is not a share of a surface's light, 0 or more", self.noise)
        })?;
        require((1..=MAX_PATHS).contains(&self.max_paths), "--max-paths", || {
            format!("{} is not between 1 and {MAX_PATHS} paths", self.max_paths)
        })?;
        if let Background::Colour(colour) = &self.background {
            require(colour.iter().all(|value| value.is_finite() && *value >= 0.0), "--background", || {
                format!("{colour:?} is not a radiance: three finite numbers, 0 or more")
            })?;
        }
        self.validate_outputs()?;
        require(self.threads <= MAX_THREADS, "--threads", || {
            format!("{} is more than {MAX_THREADS}; 0 is one per core", self.threads)
        })?;
        require(self.cache.as_ref().is_none_or(|folder| !folder.as_os_str().is_empty()), "--cache", || {
            "the path is empty".into()
        })?;
        require(self.time_budget.is_none_or(|time| time > 0.0 && time <= MAX_TIME), "--time-budget", || {
            format!("{:?} is not a time in seconds above 0, at most {MAX_TIME}", self.time_budget)
        })?;
        require(self.ray_count() <= MAX_RAYS, "--face-size", || {
            format!(
                "{} probes x 6 faces x {2} x {2} pixels x {3} x {3} samples are {1} rays, more than {MAX_RAYS}: \
                 bake fewer probes, smaller faces or fewer samples",
                self.placement.probe_count(),
                self.ray_count(),
                self.face_size,
                self.samples
            )
        })
    }

    fn validate_outputs(&self) -> Result<()> {
        let is_once = |(i, output): (usize, &OutputKind)| !self.outputs[..i].contains(output);
        require(!self.outputs.is_empty() && self.outputs.iter().enumerate().all(is_once), "--outputs", || {
            format!("{:?} does not name at least one kind of file, and each once", self.outputs)
        })?;
        require(!self.outputs.contains(&OutputKind::Envmap) || self.face_size >= 2, "--face-size", || {
            "an envmap has texels on the edges of its faces: it needs at least 2".into()
        })?;
        require((1..=MAX_MIPS).contains(&self.mips), "--mips", || {
            format!("{} is not between 1 and {MAX_MIPS}", self.mips)
        })?;
        require(self.exposure.abs() <= MAX_EXPOSURE, "--exposure", || {
            format!("{} is not between -{MAX_EXPOSURE} and {MAX_EXPOSURE} stops", self.exposure)
        })?;
        require(
            self.highlight_expansion.is_none_or(|peak| (1.0..=MAX_EXPANSION).contains(&peak)),
            "--highlight-expansion",
            || format!("{:?} is not a radiance between 1 and {MAX_EXPANSION}", self.highlight_expansion),
        )?;
        require((2..=3).contains(&self.sh_degree), "--sh-degree", || format!("{} is neither 2 nor 3", self.sh_degree))
    }

    fn ray_count(&self) -> u128 {
        let rays_per_edge = u128::from(self.face_size) * u128::from(self.samples);
        u128::from(self.placement.probe_count()) * 6 * rays_per_edge * rays_per_edge
    }
}

impl Placement {
    fn validate(&self) -> Result<()> {
        let kinds = [self.grid.is_some(), !self.probes.is_empty(), self.placed.is_some(), self.adaptive];
        match kinds.into_iter().filter(|given| *given).count() {
            0 => {
                return Err(Error::request(
                    "--grid",
                    "no probes: give --grid, --probe positions, --placed or --adaptive",
                ));
            }
            1 => {}
            _ => {
                return Err(Error::request(
                    "--grid",
                    "give only one of a grid, --probe positions, --placed and --adaptive",
                ));
            }
        }
        if let Some(grid) = self.grid {
            require(!grid.contains(&0), "--grid", || format!("{grid:?} needs at least 1 probe along each axis"))?;
        }
        require(self.levels.is_empty() || self.adaptive, "--levels", || "belongs to --adaptive".into())?;
        require(self.levels.len() <= MAX_LEVELS, "--levels", || {
            format!("{} heights are more than {MAX_LEVELS}", self.levels.len())
        })?;
        require_coordinates("--levels", &self.levels)?;
        require(self.error.is_finite() && self.error >= 0.0, "--error", || {
            format!("{} is not a relative error, 0 or more", self.error)
        })?;
        require((1..=MAX_PROBES as u32).contains(&self.max_probes), "--max-probes", || {
            format!("{} is not between 1 and {MAX_PROBES} probes", self.max_probes)
        })?;
        require(self.time.is_none_or(|time| time > 0.0 && time <= MAX_TIME), "--time", || {
            format!("{:?} is not a time in seconds above 0, at most {MAX_TIME}", self.time)
        })?;
        require(self.held_out <= MAX_HELD_OUT, "--held-out", || {
            format!("{} positions are more than {MAX_HELD_OUT}", self.held_out)
        })?;
        self.bounds.map_or(Ok(()), |corners| require_box("--bounds", corners))?;
        self.probes.iter().try_for_each(|probe| require_coordinates("--probe", probe))?;
        require((0.0..=1.0).contains(&self.overlap), "--overlap", || {
            format!("{} is not a fraction of the spacing from 0 to 1", self.overlap)
        })?;
        require(self.probe_count() <= MAX_PROBES as u64, "--grid", || {
            format!("{} probes are more than {MAX_PROBES}", self.probe_count())
        })
    }

    /// How many probes are asked for. Saturates, so that an absurd grid is still an absurd number.
    fn probe_count(&self) -> u64 {
        match self.grid {
            Some(grid) => grid.into_iter().map(u64::from).fold(1, u64::saturating_mul),
            None if self.adaptive => u64::from(self.max_probes),
            None => self.probes.len() as u64,
        }
    }
}

impl SplatInput {
    fn validate(&self) -> Result<()> {
        require(!self.path.as_os_str().is_empty(), "--splats", || "the path is empty".into())?;
        self.transform.validate("--splat-transform")?;
        self.crop.iter().try_for_each(Crop::validate)?;
        require((0.0..=1.0).contains(&self.min_opacity), "--min-opacity", || {
            format!("{} is not an opacity from 0 to 1", self.min_opacity)
        })
    }
}

impl Crop {
    fn validate(&self) -> Result<()> {
        match *self {
            Self::Box(corners) => require_box("--crop", corners),
            Self::Sphere(ball) => {
                require_coordinates("--crop", &ball)?;
                require(ball[3] > 0.0, "--crop", || format!("{} is not a radius: it must be above 0", ball[3]))
            }
        }
    }
}

impl MeshInput {
    fn validate(&self) -> Result<()> {
        require(!self.path.as_os_str().is_empty(), "--mesh", || "the path is empty".into())?;
        self.transform.validate("--mesh-transform")
    }
}

impl Transform {
    fn validate(&self, flag: &str) -> Result<()> {
        require_coordinates(flag, &self.translation)?;
        let length = self.rotation.iter().map(|value| value * value).sum::<f64>().sqrt();
        // Written by hand or rounded to a few digits, a quaternion is still meant as one; NaN fails the comparison.
        require((length - 1.0).abs() < 1e-3, flag, || {
            format!("{:?} is not a unit quaternion x, y, z, w: its length is {length}", self.rotation)
        })?;
        // The determinant divides, and f32 geometry must survive it.
        require(self.scale.iter().all(|factor| (1e-9..=1e9).contains(&factor.abs())), flag, || {
            format!("{:?} is not a scale: every factor must be between 1e-9 and 1e9, or its negative", self.scale)
        })
    }
}

fn require_box(flag: &str, corners: [f64; 6]) -> Result<()> {
    require_coordinates(flag, &corners)?;
    let [x0, y0, z0, x1, y1, z1] = corners;
    require(x0 < x1 && y0 < y1 && z0 < z1, flag, || {
        format!("{x0},{y0},{z0} to {x1},{y1},{z1} is no box: the first corner must be below the second in x, y and z")
    })
}

fn require_coordinates(flag: &str, values: &[f64]) -> Result<()> {
    require(values.iter().all(|value| value.abs() <= MAX_COORDINATE), flag, || {
        format!(
            "{values:?} are not coordinates: every number must be finite and at most {MAX_COORDINATE:e} metres from 0"
        )
    })
}

fn require(holds: bool, flag: &str, why: impl FnOnce() -> String) -> Result<()> {
    if holds { Ok(()) } else { Err(Error::request(flag, why())) }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A job that is right, changed by `change`.
    fn job_with(change: impl FnOnce(&mut Job)) -> Job {
        let splats = vec![SplatInput::new("a.ply")];
        let placement =
            Placement { bounds: Some([0.0, 0.0, 0.0, 4.0, 2.0, 4.0]), grid: Some([2, 1, 2]), ..Placement::default() };
        let mut job = Job { splats, placement, output: Some("out".into()), ..Job::default() };
        change(&mut job);
        job
    }

    fn adaptive(change: impl FnOnce(&mut Placement)) -> Placement {
        let mut placement = Placement { adaptive: true, ..Placement::default() };
        change(&mut placement);
        placement
    }

    #[test]
    fn a_job_with_inputs_output_and_probes_is_valid() {
        job_with(|_| ()).validate().unwrap();
        job_with(|job| job.placement = adaptive(|it| it.levels = vec![1.5, -2.0])).validate().unwrap();
        job_with(|job| job.placement = Placement { probes: vec![[0.0; 3]], ..Placement::default() })
            .validate()
            .unwrap();
    }

    #[test]
    fn every_fault_is_an_error_that_names_its_flag() {
        type Fault = (&'static str, fn(&mut Job));
        let faults: &[Fault] = &[
            ("--splats", |job| job.splats.clear()),
            ("--splats", |job| job.splats[0].path = "".into()),
            ("--splat-transform", |job| job.splats[0].transform.rotation = [0.0; 4]),
            ("--splat-transform", |job| job.splats[0].transform.rotation[0] = f64::NAN),
            ("--splat-transform", |job| job.splats[0].transform.scale[1] = 0.0),
            ("--splat-transform", |job| job.splats[0].transform.translation[2] = f64::INFINITY),
            ("--crop", |job| job.splats[0].crop = Some(Crop::Box([0.0, 0.0, 0.0, 1.0, 0.0, 1.0]))),
            ("--crop", |job| job.splats[0].crop = Some(Crop::Sphere([0.0, f64::NAN, 0.0, 1.0]))),
            ("--min-opacity", |job| job.splats[0].min_opacity = 1.5),
            ("-o", |job| job.output = None),
            ("--grid", |job| job.placement.grid = None),
            ("--grid", |job| job.placement.probes = vec![[0.0; 3]]),
            ("--grid", |job| job.placement.grid = Some([2, 0, 2])),
            ("--grid", |job| job.placement.grid = Some([u32::MAX; 3])),
            ("--bounds", |job| job.placement.bounds = Some([0.0, 0.0, 0.0, 4.0, -2.0, 4.0])),
            ("--bounds", |job| job.placement.bounds = Some([0.0, 0.0, f64::NAN, 4.0, 2.0, 4.0])),
            ("--probe", |job| job.placement = Placement { probes: vec![[0.0, 1e300, 0.0]], ..Placement::default() }),
            ("--overlap", |job| job.placement.overlap = -0.1),
            ("--grid", |job| job.placement.adaptive = true),
            ("--levels", |job| job.placement.levels = vec![1.0]),
            ("--levels", |job| job.placement = adaptive(|it| it.levels = vec![f64::NAN])),
            ("--error", |job| job.placement = adaptive(|it| it.error = -0.1)),
            ("--max-probes", |job| job.placement = adaptive(|it| it.max_probes = 0)),
            ("--time", |job| job.placement = adaptive(|it| it.time = Some(0.0))),
            ("--held-out", |job| job.placement = adaptive(|it| it.held_out = u32::MAX)),
            ("--face-size", |job| job.face_size = 0),
            ("--face-size", |job| job.face_size = 8193),
            ("--samples", |job| job.samples = 0),
            ("--t-cutoff", |job| job.t_cutoff = 1.0),
            ("--footprint", |job| job.footprint = Footprint::Train(0.5)),
            ("--footprint", |job| job.footprint = Footprint::Train(f64::INFINITY)),
            ("--t-near", |job| job.t_near = f32::NAN),
            ("--background", |job| job.background = Background::Colour([0.0, -1.0, 0.0])),
            ("--outputs", |job| job.outputs.clear()),
            ("--outputs", |job| job.outputs = vec![OutputKind::Mips, OutputKind::Mips]),
            ("--face-size", |job| (job.outputs, job.face_size) = (vec![OutputKind::Envmap], 1)),
            ("--mips", |job| job.mips = 0),
            ("--exposure", |job| job.exposure = f32::NAN),
            ("--sh-degree", |job| job.sh_degree = 4),
            ("--highlight-expansion", |job| job.highlight_expansion = Some(0.5)),
            ("--threads", |job| job.threads = usize::MAX),
            ("--face-size", |job| (job.placement.grid, job.face_size) = (Some([100, 10, 100]), 2048)),
        ];
        for &(flag, change) in faults {
            match job_with(change).validate() {
                Err(Error::Request { field, .. }) => assert_eq!(field, flag),
                other => panic!("{flag}: {other:?}"),
            }
        }
    }
}
