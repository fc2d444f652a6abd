//! Materials at the horizon, as smooth and as rough as they can be.

use glam::{DVec3, Vec2, Vec3};
use rayon::prelude::*;
use splatprobe::shade::bsdf::{Bsdf, Parameters};

use super::{Row, worse};
use crate::common::Random;

/// What the numbers are.
pub const WHAT: &str = "Materials that absorb nothing, in a white furnace, seen at cosines from 1 to 1e-4 and from behind, at roughness \
0, 1 and what is next to them: how far the share of light that they send back is from 1, of 16 384 directions \
drawn; infinite where a drawn weight is not a number at or above 0. Then, per pair of directions down to the \
horizon, how much of the light is lost or gained when the two are exchanged, relative to what is sent.";

const ROUGHNESSES: [f32; 8] = [0.0, 1e-6, 1e-3, 0.02, 0.1, 0.5, 0.999, 1.0];
const COSINES: [f32; 7] = [1.0, 0.3, 0.1, 1e-2, 1e-3, 1e-4, 0.0];

fn materials() -> Vec<(&'static str, Parameters, f64)> {
    let metal = Parameters::default();
    let dielectric = Parameters { metallic: 0.0, ..metal };
    let glass = Parameters { transmission: 1.0, ..dielectric };
    vec![
        ("white metal", metal, 0.02),
        ("white dielectric", dielectric, 0.02),
        ("dielectric of ior 2.4", Parameters { ior: 2.4, ..dielectric }, 0.02),
        ("dielectric of ior 1", Parameters { ior: 1.0, ..dielectric }, 0.02),
        ("thin glass", glass, 0.02),
        ("glass", Parameters { thickness: 1.0, ..glass }, 0.02),
        ("coated metal", Parameters { clearcoat: 1.0, ..metal }, 0.02),
        (
            "coated dielectric, coat of roughness 1",
            Parameters { clearcoat: 1.0, clearcoat_roughness: 1.0, ..dielectric },
            0.02,
        ),
        (
            "brushed metal of strength 0.5",
            Parameters { anisotropy_strength: 0.5, anisotropy_rotation: 0.4, ..metal },
            0.05,
        ),
        // Across the brush at the horizon its albedo falls off faster than the table's cells: roughness 0.1, cosine 0.01.
        (
            "brushed metal of strength 1",
            Parameters { anisotropy_strength: 1.0, anisotropy_rotation: 0.4, ..metal },
            0.2,
        ),
    ]
}

/// All cases, measured.
pub fn rows() -> Vec<Row> {
    let furnace = |(name, material, tolerance): (&str, Parameters, f64)| {
        let worst = sweep(&material, |material, view| {
            let error = |inside| (albedo(&Bsdf::new(material, view, inside)) - 1.0).abs();
            // Only of a volume there is an inside.
            if material.thickness > 0.0 { f64::max(error(false), error(true)) } else { error(false) }
        });
        Row::new(format!("{name} in a furnace"), worst, tolerance)
    };
    let exchange = |(name, material): (&str, Parameters)| {
        Row::new(format!("{name}, exchanged"), sweep(&material, exchanged), 1e-3)
    };
    let metal = Parameters::default();
    let brushed = Parameters { anisotropy_strength: 1.0, ..metal };
    let dielectric = Parameters { metallic: 0.0, ..metal };
    let mut rows: Vec<Row> = materials().into_par_iter().map(furnace).collect();
    rows.extend([("white metal", metal), ("brushed metal", brushed), ("white dielectric", dielectric)].map(exchange));
    rows
}

/// The largest of `measure(material, view)` over roughnesses, cosines of the view and, of brushed metal, azimuths.
fn sweep(material: &Parameters, measure: impl Fn(&Parameters, Vec3) -> f64 + Sync) -> f64 {
    let azimuths: &[f32] = if material.anisotropy_strength > 0.0 { &[0.3, 1.1, 1.9] } else { &[0.3] };
    let views = COSINES.into_iter().flat_map(|cosine| azimuths.iter().map(move |&azimuth| view(cosine, azimuth)));
    let cases: Vec<(f32, Vec3)> = views.flat_map(|view| ROUGHNESSES.map(|roughness| (roughness, view))).collect();
    cases
        .into_par_iter()
        .map(|(roughness, view)| measure(&Parameters { roughness, ..*material }, view))
        .reduce(|| 0.0, worse)
}

fn view(cosine: f32, azimuth: f32) -> Vec3 {
    (Vec2::from_angle(azimuth) * (1.0 - cosine * cosine).sqrt()).extend(cosine)
}

/// Share of light from everywhere that reaches the view: the channel that is furthest from 1.
fn albedo(bsdf: &Bsdf) -> f64 {
    const COUNT: usize = 128;
    let mut random = Random(31);
    let mut sum = DVec3::ZERO;
    // Stratified in what chooses the lobe and in one angle.
    for i in 0..COUNT * COUNT {
        let cell =
            |k: usize, random: &mut Random| ((k as f64 + random.uniform(0.0, 1.0)) / COUNT as f64).min(1.0 - 1e-7);
        let (x, y) = (cell(i % COUNT, &mut random), cell(i / COUNT, &mut random));
        let point = DVec3::new(x, y, random.uniform(0.0, 1.0 - 1e-7)).as_vec3();
        let Some(sample) = bsdf.sample(point) else { continue };
        if !(sample.weight.is_finite() && sample.weight.min_element() >= 0.0 && sample.direction.is_finite()) {
            return f64::INFINITY;
        }
        sum += sample.weight.as_dvec3();
    }
    let albedo = sum / (COUNT * COUNT) as f64;
    albedo.to_array().into_iter().max_by(|a, b| (a - 1.0).abs().total_cmp(&(b - 1.0).abs())).unwrap_or(0.0)
}

/// The largest difference of the response there and back, relative to the greater of the two.
fn exchanged(material: &Parameters, there: Vec3) -> f64 {
    COSINES
        .into_iter()
        .filter(|&cosine| cosine >= 1e-4 && there.z >= 1e-4)
        .flat_map(|cosine| [0.0, 0.3, 2.0, 3.4].map(|azimuth| view(cosine, azimuth)))
        .map(|back| {
            // Without the light's cosine.
            let response = |view: Vec3, light: Vec3| Bsdf::new(material, view, false).evaluate(light).value.x / light.z;
            let (a, b) = (f64::from(response(there, back)), f64::from(response(back, there)));
            if a == b { 0.0 } else { (a - b).abs() / a.max(b) }
        })
        .fold(0.0, worse)
}
