//! The one place where a job's values are checked, alone and together.

use super::footprint::MIN_FOCAL;
use super::{Background, Crop, Footprint, Job, MeshInput, Placement, SplatInput, Transform};
use crate::{Error, Result};

/// Largest edge of a cube face, in pixels: a probe's six faces then take 6 GiB while they are traced.
pub const MAX_FACE_SIZE: u32 = 8192;

/// Largest number of rays per pixel and axis.
pub const MAX_SAMPLES: u32 = 64;

/// Most paths per ray that meets a surface.
pub const MAX_PATHS: u32 = 1 << 20;

/// Most probes of one bake; each is a folder.
pub const MAX_PROBES: usize = 1_000_000;

/// Most rays of one bake: a day and a half at 8 million a second. More is a slip of the finger.
const MAX_RAYS: u128 = 1_000_000_000_000;

/// Coordinates beyond this, in metres, are not a scene on or near the Earth.
const MAX_COORDINATE: f64 = 1e9;

/// More threads than any machine in reach has cores.
const MAX_THREADS: usize = 1024;

impl Job {
    /// Checks every setting, alone and together. The first fault is the error, named by its flag, with what would be
    /// right. Files are not touched.
    pub fn validate(&self) -> Result<()> {
        require(!self.splats.is_empty() || !self.meshes.is_empty(), "--splats", || {
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
        require(self.threads <= MAX_THREADS, "--threads", || {
            format!("{} is more than {MAX_THREADS}; 0 is one per core", self.threads)
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

    fn ray_count(&self) -> u128 {
        let rays_per_edge = u128::from(self.face_size) * u128::from(self.samples);
        u128::from(self.placement.probe_count()) * 6 * rays_per_edge * rays_per_edge
    }
}

impl Placement {
    fn validate(&self) -> Result<()> {
        match (self.grid, self.bounds) {
            (Some(_), _) if !self.probes.is_empty() => {
                return Err(Error::request("--grid", "give either a grid or --probe positions, not both"));
            }
            (Some(grid), _) => {
                require(!grid.contains(&0), "--grid", || format!("{grid:?} needs at least 1 probe along each axis"))?
            }
            (None, _) => {
                require(!self.probes.is_empty(), "--grid", || "no probes: give --grid or --probe positions".into())?
            }
        }
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

    #[test]
    fn a_job_with_inputs_output_and_probes_is_valid() {
        job_with(|_| ()).validate().unwrap();
        job_with(|job| job.placement = Placement { probes: vec![[0.0; 3]], ..Placement::default() })
            .validate()
            .unwrap();
    }

    #[test]
    fn every_fault_is_an_error_that_names_its_flag() {
        type Fault = (&'static str, fn(&mut Job));
        let faults: [Fault; 28] = [
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
            ("--face-size", |job| job.face_size = 0),
            ("--face-size", |job| job.face_size = 8193),
            ("--samples", |job| job.samples = 0),
            ("--t-cutoff", |job| job.t_cutoff = 1.0),
            ("--footprint", |job| job.footprint = Footprint::Train(0.5)),
            ("--footprint", |job| job.footprint = Footprint::Train(f64::INFINITY)),
            ("--t-near", |job| job.t_near = f32::NAN),
            ("--background", |job| job.background = [0.0, -1.0, 0.0].into()),
            ("--threads", |job| job.threads = usize::MAX),
            ("--face-size", |job| (job.placement.grid, job.face_size) = (Some([100, 10, 100]), 2048)),
        ];
        for (flag, change) in faults {
            match job_with(change).validate() {
                Err(Error::Request { field, .. }) => assert_eq!(field, flag),
                other => panic!("{flag}: {other:?}"),
            }
        }
    }
}
