//! What a rasteriser's approximation does at the edges of a cubemap, beside rays: the same directions seen from both
//! faces that share an edge.
//!
//! ```text
//! cargo bench --bench seams                                   # the generated interior
//! cargo bench --bench seams -- --splats scene.ply --probe 0,1.5,0 --sizes 64,256
//! ```
//!
//! EWA splatting as 3DGS and Splatfacto do it (Zwicker et al. 2001; Kerbl et al. 2023, section 4 and its rasteriser): a
//! Gaussian's image is a 2D Gaussian by the perspective's Jacobian at its mean, widened by 0.3 square pixels and blended in
//! the order of the means' depths. All three change with the face. It is computed here in f64 at the edge itself, so that
//! nothing but the approximation is measured. Differences are of display values, the largest of the three channels.

#[path = "common/arguments.rs"]
mod arguments;
#[path = "common/scene.rs"]
mod scene;

use self::arguments::Arguments;
use self::scene::scene;
use glam::{DMat2, DMat3, DVec2, DVec3};
use rayon::prelude::*;
use splatprobe::bvh::Bvh;
use splatprobe::generate::InteriorSettings;
use splatprobe::scene::splats::ALPHA_MIN;
use splatprobe::scene::{Scene, colour, sh};
use splatprobe::shade::UnlitSurfaces;
use splatprobe::trace::{BeamTracer, Face, Radiance, Tile, TileTracer, TraceSettings};

/// What 3DGS adds to the variances of an image, in square pixels.
const LOW_PASS: f64 = 0.3;

/// Nearer means are not drawn, in units of the scene.
const NEAR: f64 = 0.2;

/// Means farther from the middle than this many times the image's half width are taken from there for the Jacobian.
const LIMIT: f64 = 1.3;

/// 3DGS ends a pixel at this transmittance.
const CUTOFF: f64 = 1e-4;

/// Directions per edge of the cube.
const PER_EDGE: usize = 100;

fn main() {
    let arguments = Arguments::parse(150_000, &[64, 256]);
    let settings = InteriorSettings { gaussians: arguments.gaussians, ..InteriorSettings::default() };
    let mut scene = scene(arguments.splats.as_deref(), settings);
    let bvh = Bvh::build(&mut scene);
    let origin = arguments.probe - scene.origin;
    println!("{} Gaussians, probe {}, {PER_EDGE} directions on each of 12 edges", scene.splats.len(), arguments.probe);
    println!("| seen by | median | 95 % | worst |");
    println!("|---|---|---|---|");
    let surfaces = UnlitSurfaces::new(&scene.meshes);
    let tracer = BeamTracer::new(&scene, &bvh, &surfaces, TraceSettings::default());
    let traced = differences(|face, direction| traced(&tracer, origin, face, direction));
    for &size in &arguments.sizes {
        let views = Face::ALL.map(|face| View::new(&scene, origin, face, size));
        let splatted = differences(|face, direction| views[face as usize].at(direction));
        report(&format!("EWA splatting, {size} px"), &splatted);
        let ratios = [0.5, 1.0].map(|share| quantile(&splatted, share) / quantile(&traced, share));
        println!("| over rays: times | {:.0} | | {:.0} |", ratios[0], ratios[1]);
    }
    report("rays", &traced);
}

fn report(name: &str, sorted: &[f64]) {
    let [median, most, worst] = [0.5, 0.95, 1.0].map(|share| quantile(sorted, share));
    println!("| {name} | {median:.1e} | {most:.1e} | {worst:.1e} |");
}

fn quantile(sorted: &[f64], share: f64) -> f64 {
    sorted[((sorted.len() - 1) as f64 * share) as usize]
}

/// How much the display colours of directions on the edges differ between the two faces, in ascending order. `seen` gives
/// the colour in a face.
fn differences(seen: impl Fn(Face, DVec3) -> DVec3 + Sync) -> Vec<f64> {
    let mut pairs = Vec::new();
    for (i, a) in Face::ALL.into_iter().enumerate() {
        for b in Face::ALL.into_iter().skip(i + 1) {
            let [look_a, look_b] = [a, b].map(|face| face.axes()[2]);
            if look_a.dot(look_b) == 0.0 {
                let along = (0..PER_EDGE).map(|k| (k as f64 + 0.5) / PER_EDGE as f64 * 2.0 - 1.0);
                pairs.extend(along.map(|along| (a, b, look_a + look_b + look_a.cross(look_b) * along)));
            }
        }
    }
    let difference = |&(a, b, direction): &(Face, Face, DVec3)| {
        let [from_a, from_b] = [a, b].map(|face| seen(face, direction).map(|x| x.clamp(0.0, 1.0)));
        (from_a - from_b).abs().max_element()
    };
    let mut differences: Vec<f64> = pairs.par_iter().map(difference).collect();
    differences.sort_by(f64::total_cmp);
    differences
}

/// What the tracer gives for a direction on the edge of a face: the texel there of a face so large that its centre lies on
/// the edge to 1e-9.
fn traced(tracer: &dyn TileTracer, origin: DVec3, face: Face, direction: DVec3) -> DVec3 {
    const FACE_SIZE: u32 = 1 << 30;
    let point = image_point(face, direction).map(|at| ((at + 1.0) / 2.0 * f64::from(FACE_SIZE)).floor());
    let [x, y] = point.to_array().map(|texel| (texel as i32).clamp(0, FACE_SIZE as i32 - 1));
    let mut texel = [Radiance::default()];
    tracer.trace_tile(origin, &Tile { face, face_size: FACE_SIZE, x, y, width: 1, height: 1 }, &mut texel);
    let linear = texel[0].to_linear(Default::default(), Default::default()).0;
    linear.map(colour::linear_to_srgb).as_dvec3()
}

/// Right and down of a direction in a face's image, from -1 to 1.
fn image_point(face: Face, direction: DVec3) -> DVec2 {
    let [right, up, look] = face.axes();
    DVec2::new(right.dot(direction), -up.dot(direction)) / look.dot(direction)
}

/// A face as a rasteriser sees the scene through it.
struct View {
    face: Face,
    /// Nearest first.
    splats: Vec<Splat>,
}

struct Splat {
    depth: f64,
    /// In units of half the image's width, as `inverse_covariance` is.
    centre: DVec2,
    inverse_covariance: DMat2,
    opacity: f64,
    colour: DVec3,
}

impl View {
    fn new(scene: &Scene, origin: DVec3, face: Face, size: u32) -> Self {
        let [right, up, look] = face.axes();
        let view_from_world = DMat3::from_cols(right, -up, look).transpose();
        // Pixels in units of half the width.
        let pixel = 2.0 / f64::from(size);
        let splats = &scene.splats;
        let splat = |i: usize| {
            let from_origin = splats.means[i].as_dvec3() - origin;
            let mean = view_from_world * from_origin;
            if mean.z < NEAR {
                return None;
            }
            let held = DVec2::new(mean.x, mean.y) / mean.z;
            let held = held.clamp(DVec2::splat(-LIMIT), DVec2::splat(LIMIT));
            let inverse = 1.0 / mean.z;
            let jacobian = DMat3::from_cols(
                DVec3::new(inverse, 0.0, 0.0),
                DVec3::new(0.0, inverse, 0.0),
                DVec3::new(-held.x * inverse, -held.y * inverse, 0.0),
            );
            let image_from_world = jacobian * view_from_world;
            let unit_from_world = splats.unit_from_world[i].as_dmat3();
            let image_from_unit = image_from_world * unit_from_world.inverse();
            let covariance = image_from_unit * image_from_unit.transpose();
            let blur = LOW_PASS * pixel * pixel;
            let covariance = DMat2::from_cols(
                DVec2::new(covariance.x_axis.x + blur, covariance.x_axis.y),
                DVec2::new(covariance.y_axis.x, covariance.y_axis.y + blur),
            );
            let colour = sh::evaluate(splats.sh_degree, splats.sh_of(i), from_origin.normalize().as_vec3());
            Some(Splat {
                depth: mean.z,
                centre: DVec2::new(mean.x, mean.y) / mean.z,
                inverse_covariance: covariance.inverse(),
                opacity: f64::from(splats.opacities[i]),
                colour: colour.as_dvec3(),
            })
        };
        let mut splats: Vec<Splat> = (0..splats.len()).into_par_iter().filter_map(splat).collect();
        splats.par_sort_by(|a, b| a.depth.total_cmp(&b.depth));
        Self { face, splats }
    }

    fn at(&self, direction: DVec3) -> DVec3 {
        let point = image_point(self.face, direction);
        let (mut colour, mut transmittance) = (DVec3::ZERO, 1.0);
        for splat in &self.splats {
            let offset = point - splat.centre;
            let m2 = offset.dot(splat.inverse_covariance * offset);
            let alpha = (splat.opacity * (-0.5 * m2).exp()).min(0.99);
            if !(m2 >= 0.0 && alpha >= ALPHA_MIN) {
                continue;
            }
            colour += splat.colour * alpha * transmittance;
            transmittance *= 1.0 - alpha;
            if transmittance < CUTOFF {
                break;
            }
        }
        colour
    }
}
