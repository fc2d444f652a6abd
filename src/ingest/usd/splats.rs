//! ParticleField3DGaussianSplat prims (UsdVol): arrays of a schema whose fallbacks and length rules are written down here.
//!
//! Scales are linear standard deviations, opacities linear; spherical harmonics are grouped by particle, red, green and blue
//! of a coefficient together, in the order of [`crate::scene::sh`]. Each array has a float and a half attribute; the float
//! one is preferred where it is authored. An array longer than the particles is cut, a shorter one is ignored.

use std::path::Path;
use std::sync::Arc;

use glam::{DQuat, DVec3};
use half::f16;
use openusd::gf;
use openusd::sdf::Value;
use openusd::usd::Prim;

use super::walk::Below;
use super::{OpenedStage, with_stage};
use crate::error::{Error, Result};
use crate::ingest::CHUNK;
use crate::ingest::sanitize::FileGaussian;
use crate::ingest::source::{SplatFile, SplatPart, SplatSource};
use crate::job::Order;
use crate::scene::SplatEncoding;
use crate::scene::sh::{MAX_DEGREE, coefficient_count};

/// So many Gaussians may a file place, or one for each of its bytes: references multiply what a small file holds.
const MIN_PLACED: usize = 1 << 20;

/// Opens all splats of the stage at `path`.
///
/// # Errors
/// [`Error::Invalid`] when the stage cannot be composed, an attribute is of another type than the schema's, or there are
/// no splats; [`Error::Unsupported`] for degrees above 4.
pub fn open_splats(path: &Path) -> Result<SplatFile> {
    let most = std::fs::metadata(path).map_err(|source| Error::read(path, source))?.len();
    let most = usize::try_from(most).unwrap_or(usize::MAX).max(MIN_PLACED);
    with_stage(path, |stage| {
        let mut parts = Vec::new();
        let mut orders = Vec::new();
        let mut placed = 0usize;
        stage.walk(|prim, file_from_prim| {
            if stage.kind(prim)? != "ParticleField3DGaussianSplat" {
                return Ok(Below::Visit);
            }
            let particles = Particles::read(stage, prim)?;
            placed = placed.saturating_add(particles.count());
            if placed > most {
                let what =
                    format!("more than {most} Gaussians from {} on, instances counted; place fewer", prim.path());
                return Err(Error::unsupported(path, what));
            }
            if !file_from_prim.matrix3.determinant().is_normal() {
                return Err(stage.invalid(prim, "it is flattened: a scale factor is 0 or out of range"));
            }
            orders.push(order(stage, prim)?);
            parts.push(SplatPart { file_from_part: *file_from_prim, source: Box::new(Arc::new(particles)) });
            Ok(Below::Visit)
        })?;
        if placed == 0 {
            let what =
                "it has no particles of ParticleField3DGaussianSplat prims that are active, visible and rendered";
            return Err(Error::invalid(path, "stage", what));
        }
        let order = orders.first().copied().flatten().filter(|order| orders.iter().all(|it| *it == Some(*order)));
        Ok(SplatFile {
            format: format!("USD ParticleField3DGaussianSplat, {} m per unit", stage.metres_per_unit),
            frame: stage.frame,
            encoding: SplatEncoding::SrgbDisplay,
            order,
            parts,
            files: stage.resolver.log.files(),
        })
    })
}

/// The order that a prim asks for. `zDepth`, the schema's fallback, needs a camera's axis, which a probe has not.
fn order(stage: &OpenedStage, prim: &Prim) -> Result<Option<Order>> {
    Ok(match stage.token(prim, "sortingModeHint")?.as_deref() {
        Some("cameraDistance") => Some(Order::CameraDistance),
        Some("rayHitDistance") => Some(Order::RayHitDistance),
        _ => None,
    })
}

/// The arrays of one prim; what is absent is empty.
#[derive(Debug)]
struct Particles {
    positions: Array<3>,
    /// w x y z.
    orientations: Array<4>,
    scales: Array<3>,
    opacities: Array<1>,
    sh_degree: u8,
    coefficients: Array<3>,
}

impl Particles {
    fn read(stage: &OpenedStage, prim: &Prim) -> Result<Self> {
        let positions: Array<3> = array(stage, prim, "positions")?;
        let count = positions.len();
        let orientations = array(stage, prim, "orientations")?.of_at_least(count);
        let scales = array(stage, prim, "scales")?.of_at_least(count);
        let opacities = array(stage, prim, "opacities")?.of_at_least(count);
        let mut sh_degree = match stage.value(prim, "radiance:sphericalHarmonicsDegree")? {
            None => 3,
            Some(Value::Int(degree)) => {
                u8::try_from(degree).ok().filter(|degree| *degree <= MAX_DEGREE).ok_or_else(|| {
                    let what = format!("{}: spherical harmonics of degree {degree}; 0 to 4 are read", prim.path());
                    Error::unsupported(stage.path, what)
                })?
            }
            Some(_) => return Err(stage.invalid(prim, "radiance:sphericalHarmonicsDegree is not an int")),
        };
        let per_particle = coefficient_count(sh_degree);
        let coefficients: Array<3> = array(stage, prim, "radiance:sphericalHarmonicsCoefficients")?;
        let coefficients = coefficients.of_at_least(count.saturating_mul(per_particle));
        if coefficients.len() == 0 {
            sh_degree = 0;
        }
        Ok(Self { positions, orientations, scales, opacities, sh_degree, coefficients })
    }
}

impl SplatSource for Particles {
    fn count(&self) -> usize {
        self.positions.len()
    }

    fn sh_degree(&self) -> u8 {
        self.sh_degree
    }

    fn for_each_in_chunk(&self, chunk: usize, sink: &mut dyn FnMut(&mut FileGaussian)) -> Result<()> {
        let per_channel = coefficient_count(self.sh_degree);
        let mut gaussian = FileGaussian::default();
        for i in chunk * CHUNK..((chunk + 1) * CHUNK).min(self.count()) {
            let [w, x, y, z] = self.orientations.get(i).unwrap_or([1.0, 0.0, 0.0, 0.0]).map(f64::from);
            gaussian.mean = DVec3::from(self.positions.get(i).unwrap_or_default().map(f64::from));
            gaussian.rotation = DQuat::from_xyzw(x, y, z, w);
            gaussian.standard_deviations = DVec3::from(self.scales.get(i).unwrap_or([1.0; 3]).map(f64::from));
            gaussian.opacity = f64::from(self.opacities.get(i).unwrap_or([1.0])[0]);
            for k in 0..per_channel {
                // Without coefficients a particle is grey, which is what zeros mean.
                let rgb = self.coefficients.get(i * per_channel + k).unwrap_or_default();
                for (channel, value) in rgb.into_iter().enumerate() {
                    gaussian.coefficients[channel * per_channel + k] = value;
                }
            }
            sink(&mut gaussian);
        }
        Ok(())
    }
}

/// Vectors of `N` numbers in the precision that the file has.
#[derive(Debug)]
enum Array<const N: usize> {
    Float(Vec<[f32; N]>),
    Half(Vec<[f16; N]>),
}

impl<const N: usize> Default for Array<N> {
    fn default() -> Self {
        Self::Float(Vec::new())
    }
}

impl<const N: usize> Array<N> {
    fn len(&self) -> usize {
        match self {
            Self::Float(values) => values.len(),
            Self::Half(values) => values.len(),
        }
    }

    /// The array, unless it is too short, which is as good as absent.
    fn of_at_least(self, count: usize) -> Self {
        if self.len() < count { Self::default() } else { self }
    }

    #[inline]
    fn get(&self, i: usize) -> Option<[f32; N]> {
        match self {
            Self::Float(values) => values.get(i).copied(),
            Self::Half(values) => values.get(i).map(|value| value.map(f16::to_f32)),
        }
    }
}

/// The array attribute `name`, or the one of half precision (its name ends with h), or none.
fn array<const N: usize>(stage: &OpenedStage, prim: &Prim, name: &str) -> Result<Array<N>>
where
    Array<N>: FromValue,
{
    for name in [name, &format!("{name}h")] {
        if let Some(value) = stage.value(prim, name)? {
            let array = <Array<N> as FromValue>::from_value(value);
            return array.ok_or_else(|| stage.invalid(prim, format!("{name} is not of the schema's type")));
        }
    }
    Ok(Array::default())
}

/// Arrays of the types that the schema has.
trait FromValue: Sized {
    fn from_value(value: Value) -> Option<Self>;
}

impl FromValue for Array<1> {
    fn from_value(value: Value) -> Option<Self> {
        match value {
            Value::FloatVec(values) => Some(Self::Float(bytemuck::cast_vec(values))),
            Value::HalfVec(values) => Some(Self::Half(bytemuck::cast_vec(values))),
            _ => None,
        }
    }
}

impl FromValue for Array<3> {
    fn from_value(value: Value) -> Option<Self> {
        match value {
            Value::Vec3fVec(values) => Some(Self::Float(bytemuck::cast_vec::<gf::Vec3f, _>(values))),
            Value::Vec3hVec(values) => Some(Self::Half(bytemuck::cast_vec::<gf::Vec3h, _>(values))),
            _ => None,
        }
    }
}

impl FromValue for Array<4> {
    fn from_value(value: Value) -> Option<Self> {
        match value {
            Value::QuatfVec(values) => Some(Self::Float(bytemuck::cast_vec::<gf::Quatf, _>(values))),
            Value::QuathVec(values) => Some(Self::Half(bytemuck::cast_vec::<gf::Quath, _>(values))),
            _ => None,
        }
    }
}
