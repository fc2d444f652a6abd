//! How a surface scatters light: glTF 2.0's metallic-roughness model with its extensions, evaluated, sampled, and conserving
//! energy.
//!
//! From the top: a clear coat, sheen, and the base, a mixture of metal and dielectric. The base reflects at GGX microfacets;
//! under the dielectric's reflection lies Lambert's diffuse albedo, or light passes through it (glTF 2.0, appendix B;
//! KHR_materials_clearcoat, _sheen, _specular, _ior, _transmission, _volume, _anisotropy, _iridescence). Where the
//! specification leaves the choice, energy decides:
//!
//! - the dielectric's Fresnel term is exact, not Schlick's, scaled between KHR_materials_specular's ends;
//! - what metal and transmitting interfaces lose after one scattering at a microfacet returns as a broad lobe (Kulla and
//!   Conty 2017), reciprocal in both cases and on both sides;
//! - diffuse light leaves through the interface that it entered by: its lobe is weighted by what the interface lets through
//!   in both directions (Kelemen and Szirmay-Kalos 2001), so a white base reflects all light at any roughness;
//! - coat and sheen take from the base what they reflect themselves, as seen from the view, as their extensions define it.
//!   That conserves energy and is not reciprocal; everything under them is.
//!
//! Radiance is basic radiance, L / n^2, which refraction leaves as it is (Veach 1997, section 5.2): light that has left all
//! glass again is not concerned, and the interfaces' albedos are 1 from both sides.

mod albedo;
mod fresnel;
mod ggx;
mod layers;
mod parameters;
mod sheen;
#[cfg(test)]
mod tests;

use std::f32::consts::{FRAC_1_PI, PI};

use glam::{Vec2, Vec3};

use self::ggx::{Ggx, reflect, refract};
use self::layers::{Dielectric, LEAST_LOSS, RoughMirror, luminance};

pub use parameters::Parameters;

/// What a surface does to the light that reaches the eye along one direction. Directions are of unit length in the local
/// frame, whose z axis is the normal on the eye's side, and point away from the surface.
#[derive(Debug, Clone)]
pub struct Bsdf {
    view: Vec3,
    /// The base's microfacets, and the view in their frame, which is turned by the anisotropy.
    microfacets: Ggx,
    turn: Vec2,
    turned_view: Vec3,
    metallic: f32,
    metal_f0: Vec3,
    mirror: RoughMirror,
    dielectric: Dielectric,
    /// Colour of transmitted light, times its share; refracted or, when the wall is thin, carried straight on.
    transmission: Vec3,
    is_thin: bool,
    coat: Ggx,
    coat_weight: f32,
    sheen_colour: Vec3,
    sheen_roughness: f32,
    /// Shares that the coat leaves to what is below it, and coat and sheen to the base.
    below_coat: f32,
    below_sheen: f32,
    /// Factors of the broad lobes, which contain what depends on the view.
    diffuse: Vec3,
    metal_rest: Vec3,
    dielectric_rest: f32,
    transmission_rest: f32,
    /// Probability of each technique of sampling.
    techniques: [f32; 5],
}

/// Techniques of sampling, in the order of [`Bsdf::techniques`].
const COAT: usize = 0;
const REFLECT: usize = 1;
const TRANSMIT: usize = 2;
const BROAD_REFLECT: usize = 3;
const BROAD_TRANSMIT: usize = 4;

/// The response to light from one direction.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Response {
    /// BSDF times the cosine of the light's angle; 1 / sr.
    pub value: Vec3,
    /// Density with which [`Bsdf::sample`] draws the direction; 1 / sr.
    pub density: f32,
}

/// A direction drawn by [`Bsdf::sample`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sample {
    /// Where the light comes from.
    pub direction: Vec3,
    /// BSDF times cosine, divided by the density.
    pub weight: Vec3,
    /// Density in 1 / sr; `None` when the direction is the only one of a mirror, which no other technique can find.
    pub density: Option<f32>,
}

/// Views closer to the horizon than this are lifted to it: shading normals can face away from the eye.
const LEAST_COSINE: f32 = 1e-4;

impl Bsdf {
    /// The material `parameters` seen along `view`. `inside` says that the eye is in the volume that the surface bounds; it
    /// is of no matter to materials without one. Values out of their range are taken as the nearest in it.
    pub fn new(parameters: &Parameters, view: Vec3, inside: bool) -> Self {
        let p = parameters.in_range();
        let inside = inside && p.thickness > 0.0 && p.transmission > 0.0;
        let view = Vec3 { z: view.z.max(LEAST_COSINE), ..view }.normalize_or(Vec3::Z);
        let microfacets = Ggx::new(p.roughness, p.anisotropy_strength);
        let turn = Vec2::from_angle(-p.anisotropy_rotation);
        let turned_view = turned(turn, view);
        let mirror = if microfacets.is_mirror() {
            RoughMirror { roughness: 0.0, anisotropy_strength: 0.0 }
        } else {
            RoughMirror { roughness: p.roughness, anisotropy_strength: p.anisotropy_strength }
        };
        let dielectric = Dielectric::new(&p, mirror, view.z, inside);
        let metal_f0 = layers::metal_f0(&p, view.z);
        let is_thin = p.thickness == 0.0;
        let mut bsdf = Self {
            view,
            microfacets,
            turn,
            turned_view,
            metallic: p.metallic,
            metal_f0,
            mirror,
            dielectric,
            transmission: (1.0 - p.metallic) * p.transmission * p.base_colour,
            is_thin,
            coat: Ggx::new(p.clearcoat_roughness, 0.0),
            coat_weight: if inside { 0.0 } else { p.clearcoat },
            sheen_colour: if inside { Vec3::ZERO } else { p.sheen_colour },
            sheen_roughness: p.sheen_roughness,
            below_coat: 1.0,
            below_sheen: 1.0,
            diffuse: Vec3::ZERO,
            metal_rest: Vec3::ZERO,
            dielectric_rest: 0.0,
            transmission_rest: 0.0,
            techniques: [0.0; 5],
        };
        bsdf.weigh_layers(&p);
        bsdf
    }

    /// Works out what each layer leaves to the others, and how often to sample it.
    fn weigh_layers(&mut self, p: &Parameters) {
        let cosine = self.view.z;
        let coat_albedo = self.coat_weight * layers::coat_albedo(&self.coat, p.clearcoat_roughness, cosine);
        let sheen_albedo = if self.sheen_colour == Vec3::ZERO {
            Vec3::ZERO
        } else {
            let white = albedo::white_sheen(cosine, self.sheen_roughness);
            // The fit of the masking sends back more than all light at some grazing directions.
            self.sheen_colour /= white.max(1.0);
            self.sheen_colour * white
        };
        self.below_coat = 1.0 - coat_albedo;
        self.below_sheen = self.below_coat * (1.0 - sheen_albedo.max_element());

        let opaque = (1.0 - self.metallic) * (1.0 - p.transmission);
        let through = (1.0 - self.metallic) * p.transmission;
        let dielectric_albedo = self.dielectric.albedo(self.turned_view);
        let diffuse_albedo = opaque * p.base_colour * (1.0 - dielectric_albedo);
        self.diffuse = diffuse_albedo * FRAC_1_PI / (1.0 - self.dielectric.albedo_average()).max(1e-6);
        let mut rest = diffuse_albedo;
        let mut transmitted_rest = 0.0;
        let (lost, average) = (self.mirror.loss(self.turned_view), self.mirror.loss_average());
        if self.metallic > 0.0 && average > LEAST_LOSS {
            let albedo = self.metallic * lost * self.mirror.rest_colour(self.metal_f0);
            self.metal_rest = albedo * FRAC_1_PI / average;
            rest += albedo;
        }
        if through > 0.0
            && let Some(shares) = self.dielectric.loss_shares(self.is_thin)
        {
            let lost = self.dielectric.loss(self.turned_view, self.is_thin, false);
            self.dielectric_rest = through * shares.reflected * lost * FRAC_1_PI / shares.near_average;
            self.transmission_rest = shares.transmitted * lost * FRAC_1_PI / shares.far_average;
            rest += through * shares.reflected * lost;
            transmitted_rest = shares.transmitted * lost;
        }
        let reflected =
            self.metallic * fresnel::schlick(self.metal_f0, cosine) + (1.0 - self.metallic) * dielectric_albedo;
        let colour = luminance(self.transmission);
        self.techniques = [
            coat_albedo,
            self.below_sheen * luminance(reflected),
            self.below_sheen * colour * (1.0 - dielectric_albedo),
            self.below_sheen * luminance(rest) + self.below_coat * luminance(sheen_albedo),
            self.below_sheen * colour * transmitted_rest,
        ];
        let sum: f32 = self.techniques.iter().sum();
        if sum > 0.0 {
            self.techniques = self.techniques.map(|share| share / sum);
        }
    }

    /// Whether it sends back no light at all.
    pub fn is_black(&self) -> bool {
        self.techniques.iter().all(|share| *share == 0.0)
    }

    /// Whether all light that it sends back comes from single directions, so that [`Self::evaluate`] gives 0 everywhere.
    pub fn is_specular(&self) -> bool {
        let broad = self.techniques[BROAD_REFLECT] + self.techniques[BROAD_TRANSMIT];
        let coat = if self.coat.is_mirror() { 0.0 } else { self.techniques[COAT] };
        let reflect = if self.microfacets.is_mirror() { 0.0 } else { self.techniques[REFLECT] };
        let transmit = if self.transmits_straight() { 0.0 } else { self.techniques[TRANSMIT] };
        broad + coat + reflect + transmit == 0.0
    }

    /// The response to light from `light`, without what mirrors reflect of single directions.
    pub fn evaluate(&self, light: Vec3) -> Response {
        if light.z > 0.0 {
            self.evaluate_reflection(light)
        } else if light.z < 0.0 && self.transmission != Vec3::ZERO {
            self.evaluate_transmission(light)
        } else {
            Response { value: Vec3::ZERO, density: 0.0 }
        }
    }

    fn evaluate_reflection(&self, light: Vec3) -> Response {
        let mut value = Vec3::ZERO;
        let mut density = self.techniques[BROAD_REFLECT] * light.z * FRAC_1_PI;
        if self.techniques[COAT] > 0.0 && !self.coat.is_mirror() {
            let half = (self.view + light).normalize_or(Vec3::Z);
            let (shadowed, drawn) = microfacet(&self.coat, self.view, light, half);
            value += self.coat_weight * layers::coat_fresnel(self.view.dot(half)) * shadowed;
            density += self.techniques[COAT] * drawn;
        }
        if self.sheen_colour != Vec3::ZERO {
            value += self.below_coat * self.sheen_colour * sheen::evaluate(self.view, light, self.sheen_roughness);
        }
        let mut base = Vec3::ZERO;
        if !self.microfacets.is_mirror() {
            let light = turned(self.turn, light);
            let half = (self.turned_view + light).normalize_or(Vec3::Z);
            let (shadowed, drawn) = microfacet(&self.microfacets, self.turned_view, light, half);
            base += self.reflectance(self.turned_view.dot(half)) * shadowed;
            density += self.techniques[REFLECT] * drawn;
            if self.metal_rest != Vec3::ZERO {
                base += self.metal_rest * self.mirror.loss(light) * light.z;
            }
            if self.dielectric_rest > 0.0 {
                base += self.dielectric_rest * self.dielectric.loss(light, self.is_thin, false) * light.z;
            }
        }
        if self.diffuse != Vec3::ZERO {
            base += self.diffuse * (1.0 - self.dielectric.albedo(turned(self.turn, light))) * light.z;
        }
        Response { value: value + self.below_sheen * base, density }
    }

    fn evaluate_transmission(&self, light: Vec3) -> Response {
        let cosine = -light.z;
        let mut share = 0.0;
        let mut density = self.techniques[BROAD_TRANSMIT] * cosine * FRAC_1_PI;
        if !self.transmits_straight() {
            let (view, light) = (self.turned_view, turned(self.turn, light));
            let mirrored = Vec3 { z: -light.z, ..light };
            if self.is_thin {
                let half = (view + mirrored).normalize_or(Vec3::Z);
                let (shadowed, drawn) = microfacet(&self.microfacets, view, mirrored, half);
                share += (1.0 - self.dielectric.reflectance(view.dot(half)).max_element()) * shadowed;
                density += self.techniques[TRANSMIT] * drawn;
            } else if let Some((shadowed, drawn, cosine)) = self.refracting_microfacet(view, light, mirrored) {
                share += (1.0 - self.dielectric.reflectance(cosine).max_element()) * shadowed;
                density += self.techniques[TRANSMIT] * drawn;
            }
        }
        if self.transmission_rest > 0.0 {
            let mirrored = turned(self.turn, Vec3 { z: cosine, ..light });
            share += self.transmission_rest * self.dielectric.loss(mirrored, self.is_thin, true) * cosine;
        }
        Response { value: self.below_sheen * share * self.transmission, density }
    }

    /// As [`microfacet`], for the normal that refracts `light` to `view`, with the cosine between view and normal (Walter et
    /// al. 2007, section 4.2; the solid angles' ratio in terms of basic radiance).
    fn refracting_microfacet(&self, view: Vec3, light: Vec3, mirrored: Vec3) -> Option<(f32, f32, f32)> {
        let eta = self.dielectric.eta;
        let half = (view + eta * light).normalize_or_zero();
        let half = if half.z < 0.0 { -half } else { half };
        let (to_view, to_light) = (view.dot(half), light.dot(half));
        if to_view <= 0.0 || to_light >= 0.0 {
            return None;
        }
        let solid_angles = eta * eta * -to_light / (to_view + eta * to_light).powi(2);
        let facets = self.microfacets.distribution(half) * to_view / view.z * solid_angles;
        let shadowed = facets * self.microfacets.masking_shadowing(view, mirrored);
        Some((shadowed, facets * self.microfacets.masking(view), to_view))
    }

    /// Reflectance of the base's microfacets.
    fn reflectance(&self, cosine: f32) -> Vec3 {
        let metal = if self.metallic > 0.0 { fresnel::schlick(self.metal_f0, cosine) } else { Vec3::ZERO };
        let dielectric = if self.metallic < 1.0 { self.dielectric.reflectance(cosine) } else { Vec3::ZERO };
        self.metallic * metal + (1.0 - self.metallic) * dielectric
    }

    /// Whether transmitted light comes from a single direction: through mirrors, and where nothing refracts.
    fn transmits_straight(&self) -> bool {
        self.microfacets.is_mirror() || (!self.is_thin && (self.dielectric.eta - 1.0).abs() < 1e-3)
    }

    /// Draws a direction from which light arrives; `random` lies in [0, 1)^3. `None` when the draw carries nothing.
    pub fn sample(&self, random: Vec3) -> Option<Sample> {
        let mut rest = random.x;
        let chosen = (0..5).find(|&technique| {
            rest -= self.techniques[technique];
            rest < 0.0
        });
        // Probabilities that sum to a rounding below 1.
        let technique = chosen.or_else(|| (0..5).rfind(|&technique| self.techniques[technique] > 0.0))?;
        let point = Vec2::new(random.y, random.z);
        let straight = |direction: Vec3, share: Vec3| {
            Some(Sample { direction, weight: share / self.techniques[technique], density: None })
        };
        let direction = match technique {
            COAT if self.coat.is_mirror() => {
                let share = self.coat_weight * layers::coat_fresnel(self.view.z);
                return straight(reflect(self.view, Vec3::Z), Vec3::splat(share));
            }
            COAT => reflect(self.view, self.coat.sample_normal(self.view, point)),
            REFLECT if self.microfacets.is_mirror() => {
                return straight(reflect(self.view, Vec3::Z), self.below_sheen * self.reflectance(self.view.z));
            }
            REFLECT => self.turned_back(reflect(self.turned_view, self.sample_normal(point))),
            TRANSMIT if self.transmits_straight() => {
                let passed = 1.0 - self.dielectric.reflectance(self.view.z).max_element();
                let direction =
                    if self.is_thin { Some(-self.view) } else { refract(self.view, Vec3::Z, self.dielectric.eta) };
                return straight(direction?, self.below_sheen * passed * self.transmission);
            }
            TRANSMIT if self.is_thin => {
                let reflected = reflect(self.turned_view, self.sample_normal(point));
                self.turned_back(Vec3 { z: -reflected.z, ..reflected })
            }
            TRANSMIT => self.turned_back(refract(self.turned_view, self.sample_normal(point), self.dielectric.eta)?),
            BROAD_REFLECT => cosine_direction(point),
            _ => -cosine_direction(point),
        };
        // What a microfacet sends to the wrong side is lost; the broad lobes make up for it.
        let is_below = matches!(technique, TRANSMIT | BROAD_TRANSMIT);
        if (direction.z < 0.0) != is_below {
            return None;
        }
        let Response { value, density } = self.evaluate(direction);
        (density > 0.0).then(|| Sample { direction, weight: value / density, density: Some(density) })
    }

    fn sample_normal(&self, random: Vec2) -> Vec3 {
        self.microfacets.sample_normal(self.turned_view, random)
    }

    fn turned_back(&self, direction: Vec3) -> Vec3 {
        turned(Vec2::new(self.turn.x, -self.turn.y), direction)
    }
}

/// A direction turned about z; `turn` holds the cosine and sine of the angle.
fn turned(turn: Vec2, direction: Vec3) -> Vec3 {
    turn.rotate(direction.truncate()).extend(direction.z)
}

/// What a mirror of microfacets reflects from `light` to `view`, times the light's cosine, and the density of drawing
/// `light` by the normals visible along `view`.
fn microfacet(ggx: &Ggx, view: Vec3, light: Vec3, half: Vec3) -> (f32, f32) {
    let facets = ggx.distribution(half) / (4.0 * view.z);
    (facets * ggx.masking_shadowing(view, light), facets * ggx.masking(view))
}

/// A direction above the surface, drawn in proportion to its cosine.
fn cosine_direction(random: Vec2) -> Vec3 {
    let radius = random.x.sqrt();
    // The horizon itself would have no density.
    (Vec2::from_angle(2.0 * PI * random.y) * radius).extend((1.0 - random.x).sqrt().max(1e-6))
}
