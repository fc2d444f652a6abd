//! Directional albedos of single lobes, integrated once per process where a material first needs them.
//!
//! What one scattering at a microfacet loses, and what a layer leaves to the one below it, follow from these, so that the
//! layers of a material together reflect what they should (Kulla and Conty 2017).

use std::f32::consts::{FRAC_PI_2, TAU};
use std::sync::LazyLock;

use glam::{Vec2, Vec3};

use super::ggx::{Ggx, reflect, refract};
use super::{fresnel, sheen};

/// Share of light that a rough mirror returns after one scattering.
pub(super) fn mirror(cosine: f32, roughness: f32) -> f32 {
    MIRROR.at([roughness, cosine.sqrt()]).x
}

/// The mean of [`mirror`] over all directions, weighted by their cosine.
pub(super) fn mirror_average(roughness: f32) -> f32 {
    MIRROR_AVERAGE.at([roughness]).x
}

/// [`mirror`] of an anisotropic one, in a direction whose first two components are those along and across its stretch.
pub(super) fn anisotropic_mirror(direction: Vec3, roughness: f32, strength: f32) -> f32 {
    let azimuth = direction.y.abs().atan2(direction.x.abs()) / FRAC_PI_2;
    ANISOTROPIC.at([strength, roughness, azimuth, direction.z.sqrt()]).x
}

/// The mean of [`anisotropic_mirror`] over all directions, weighted by their cosine.
pub(super) fn anisotropic_mirror_average(roughness: f32, strength: f32) -> f32 {
    ANISOTROPIC_AVERAGE.at([strength, roughness]).x
}

/// Shares that a rough dielectric interface reflects and transmits after one scattering; `eta` as in
/// [`fresnel::dielectric`].
pub(super) fn dielectric(cosine: f32, roughness: f32, eta: f32) -> Vec2 {
    DIELECTRIC.at([eta_coordinate(eta), roughness, cosine.sqrt()])
}

/// The mean of [`dielectric`] over all directions, weighted by their cosine.
pub(super) fn dielectric_average(roughness: f32, eta: f32) -> Vec2 {
    DIELECTRIC_AVERAGE.at([eta_coordinate(eta), roughness])
}

/// Share of light that white sheen reflects.
pub(super) fn white_sheen(cosine: f32, roughness: f32) -> f32 {
    SHEEN.at([roughness, cosine.sqrt()]).x
}

static MIRROR: LazyLock<Table<2>> = LazyLock::new(|| {
    Table::new([64, 40], |[roughness, root]| {
        over_visible_normals::<987>(direction(root, 0.0), &ggx(roughness, 0.0), |ggx, view, normal| {
            Vec2::X * reflected(ggx, view, normal)
        })
    })
});

static MIRROR_AVERAGE: LazyLock<Table<1>> =
    LazyLock::new(|| Table::new([64], |[roughness]| over_cosines(|root| MIRROR.at([roughness, root]))));

static ANISOTROPIC: LazyLock<Table<4>> = LazyLock::new(|| {
    Table::new([9, 12, 9, 16], |[strength, roughness, azimuth, root]| {
        let view = direction(root, azimuth * FRAC_PI_2);
        over_visible_normals::<610>(view, &ggx(roughness, strength), |ggx, view, normal| {
            Vec2::X * reflected(ggx, view, normal)
        })
    })
});

static ANISOTROPIC_AVERAGE: LazyLock<Table<2>> = LazyLock::new(|| {
    Table::new([9, 12], |[strength, roughness]| {
        let azimuths = (0..32).map(|i| (i as f32 + 0.5) / 32.0);
        let means = azimuths.map(|azimuth| over_cosines(|root| ANISOTROPIC.at([strength, roughness, azimuth, root])));
        means.sum::<Vec2>() / 32.0
    })
});

static DIELECTRIC: LazyLock<Table<3>> = LazyLock::new(|| {
    Table::new([33, 28, 32], |[coordinate, roughness, root]| {
        let eta = eta_at(coordinate);
        over_visible_normals::<377>(direction(root, 0.0), &ggx(roughness, 0.0), |ggx, view, normal| {
            let reflectance = fresnel::dielectric(view.dot(normal), eta);
            let transmitted = refract(view, normal, eta).filter(|wi| wi.z < 0.0);
            let transmitted = transmitted.map_or(0.0, |wi| ggx.masking_shadowing(view, wi));
            Vec2::new(reflectance * reflected(ggx, view, normal), (1.0 - reflectance) * transmitted)
        })
    })
});

static DIELECTRIC_AVERAGE: LazyLock<Table<2>> = LazyLock::new(|| {
    Table::new([33, 28], |[coordinate, roughness]| over_cosines(|root| DIELECTRIC.at([coordinate, roughness, root])))
});

static SHEEN: LazyLock<Table<2>> = LazyLock::new(|| {
    Table::new([48, 40], |[roughness, root]| {
        let view = direction(root, 0.0);
        let over_hemisphere = lattice::<4181>().map(|random| {
            let radius = (1.0 - random.y * random.y).sqrt();
            let wi = (Vec2::from_angle(TAU * random.x) * radius).extend(random.y);
            sheen::evaluate(view, wi, roughness)
        });
        // 2 pi is the solid angle that the points are spread over.
        Vec2::X * (TAU / 4181.0 * over_hemisphere.sum::<f32>())
    })
});

/// What is visible of the mirror image that a microfacet shows.
fn reflected(ggx: &Ggx, view: Vec3, normal: Vec3) -> f32 {
    let wi = reflect(view, normal);
    if wi.z > 0.0 { ggx.masking_shadowing(view, wi) } else { 0.0 }
}

/// Roughness 0 stands for what is just above it, whose widths can still be divided by.
fn ggx(roughness: f32, anisotropy_strength: f32) -> Ggx {
    Ggx::new(roughness.max(0.01), anisotropy_strength)
}

/// A direction by the root of its cosine; the horizon itself stands for what is just above it.
fn direction(root: f32, azimuth: f32) -> Vec3 {
    let cosine = (root * root).max(1e-4);
    (Vec2::from_angle(azimuth) * (1.0 - cosine * cosine).max(0.0).sqrt()).extend(cosine)
}

/// The mean over normals visible along `view` of `shadowed`, divided by the masking that their density contains.
fn over_visible_normals<const N: usize>(view: Vec3, ggx: &Ggx, shadowed: impl Fn(&Ggx, Vec3, Vec3) -> Vec2) -> Vec2 {
    let sum: Vec2 = lattice::<N>().map(|random| shadowed(ggx, view, ggx.sample_normal(view, random))).sum();
    sum / (N as f32 * ggx.masking(view))
}

/// The mean over directions, weighted by their cosine, of what `at` gives for the cosine's root. It looks the table up as
/// materials do, so that energy is conserved whatever the interpolation errs by.
fn over_cosines(at: impl Fn(f32) -> Vec2) -> Vec2 {
    (0..256).map(|i| (i as f32 + 0.5) / 256.0).map(|cosine| 2.0 / 256.0 * cosine * at(cosine.sqrt())).sum()
}

/// `N` points spread evenly over the unit square (Kronecker's sequence of the golden ratio; `N` a Fibonacci number).
fn lattice<const N: usize>() -> impl Iterator<Item = Vec2> {
    const GOLDEN: f64 = 0.618_033_988_749_894_9;
    (0..N).map(|i| Vec2::new((i as f64 * GOLDEN).fract() as f32, (i as f32 + 0.5) / N as f32))
}

/// Where an index of refraction stands on its axis, 0 to 1: by the root of the amplitude reflected at normal incidence, since
/// the critical angle changes most for indices near 1.
fn eta_coordinate(eta: f32) -> f32 {
    let amplitude = (eta - 1.0) / (eta + 1.0);
    0.5 + 0.5 * amplitude.abs().sqrt().copysign(amplitude)
}

/// The inverse of [`eta_coordinate`]. The ends of the axis stand for indices that no material has.
fn eta_at(coordinate: f32) -> f32 {
    let root = 2.0 * coordinate - 1.0;
    let amplitude = (root * root.abs()).clamp(-0.999, 0.999);
    (1.0 + amplitude) / (1.0 - amplitude)
}

/// Values over coordinates from 0 to 1, linear between nodes. Directions stand in it by the root of their cosine: nodes are
/// denser toward grazing directions, where albedos change most.
struct Table<const D: usize> {
    /// Along each axis, at least 2.
    nodes: [usize; D],
    values: Vec<Vec2>,
}

impl<const D: usize> Table<D> {
    fn new(nodes: [usize; D], value: impl Fn([f32; D]) -> Vec2) -> Self {
        let at_node = |mut index: usize| {
            let mut coordinates = [0.0; D];
            for axis in (0..D).rev() {
                coordinates[axis] = (index % nodes[axis]) as f32 / (nodes[axis] - 1) as f32;
                index /= nodes[axis];
            }
            value(coordinates)
        };
        let count = nodes.iter().product();
        // On one thread: tables are made when first asked for, by a worker thread, and workers that wait for the same table
        // could not help it. (In parallel it hung.)
        Self { nodes, values: (0..count).map(at_node).collect() }
    }

    fn at(&self, coordinates: [f32; D]) -> Vec2 {
        let mut places = [(0, 0.0); D];
        for axis in 0..D {
            let place = coordinates[axis].clamp(0.0, 1.0) * (self.nodes[axis] - 1) as f32;
            let node = (place as usize).min(self.nodes[axis] - 2);
            places[axis] = (node, place - node as f32);
        }
        (0..1 << D)
            .map(|corner: usize| {
                let (mut index, mut weight) = (0, 1.0);
                for (axis, (node, beyond)) in places.iter().enumerate() {
                    let far = corner >> axis & 1;
                    index = index * self.nodes[axis] + node + far;
                    weight *= if far == 1 { *beyond } else { 1.0 - beyond };
                }
                self.values[index] * weight
            })
            .sum()
    }
}
