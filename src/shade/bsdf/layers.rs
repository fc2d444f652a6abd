//! What the layers of a material reflect, lose and leave to each other.

use glam::Vec3;

use super::ggx::Ggx;
use super::{Parameters, albedo, fresnel};

/// Index of refraction of the coat (KHR_materials_clearcoat).
const COAT_IOR: f32 = 1.5;

/// Rec.709's luminance.
pub(super) fn luminance(colour: Vec3) -> f32 {
    colour.dot(Vec3::new(0.2126, 0.7152, 0.0722))
}

/// Reflectance of the coat's microfacets.
pub(super) fn coat_fresnel(cosine: f32) -> f32 {
    fresnel::dielectric(cosine, COAT_IOR)
}

/// Share of light that the coat reflects.
pub(super) fn coat_albedo(coat: &Ggx, roughness: f32, cosine: f32) -> f32 {
    if coat.is_mirror() { coat_fresnel(cosine) } else { albedo::dielectric(cosine, roughness, COAT_IOR).x }
}

/// The metal's reflectance at normal incidence, that of its film included as it is seen along the view.
pub(super) fn metal_f0(p: &Parameters, view_cosine: f32) -> Vec3 {
    if p.iridescence == 0.0 || p.metallic == 0.0 {
        return p.base_colour;
    }
    let film = fresnel::thin_film(view_cosine, p.iridescence_ior, p.iridescence_thickness_nm, p.base_colour);
    let seen = fresnel::schlick(p.base_colour, view_cosine).lerp(film, p.iridescence);
    at_normal_incidence(seen, 1.0, fresnel::schlick_weight(view_cosine))
}

/// The `f0` with which `f0 + (f90 - f0) weight` is `seen`, as far as a reflectance can be that.
fn at_normal_incidence(seen: Vec3, f90: f32, weight: f32) -> Vec3 {
    // At grazing directions all of them look alike.
    ((seen - f90 * weight) / (1.0 - weight).max(1e-3)).clamp(Vec3::ZERO, Vec3::ONE)
}

/// What one scattering at the base's microfacets leaves of light that nothing absorbs.
#[derive(Debug, Clone, Copy)]
pub(super) struct RoughMirror {
    /// Perceptual roughness; 0 for mirrors.
    pub roughness: f32,
    /// KHR_materials_anisotropy's; 0 for mirrors.
    pub anisotropy_strength: f32,
}

impl RoughMirror {
    /// Share of light lost in a direction, given in the frame of the anisotropy.
    pub fn loss(&self, direction: Vec3) -> f32 {
        1.0 - match (self.roughness == 0.0, self.anisotropy_strength == 0.0) {
            (true, _) => 1.0,
            (_, true) => albedo::mirror(direction.z, self.roughness),
            _ => albedo::anisotropic_mirror(direction, self.roughness, self.anisotropy_strength),
        }
    }

    /// The mean of [`Self::loss`] over all directions, weighted by their cosine.
    pub fn loss_average(&self) -> f32 {
        1.0 - match (self.roughness == 0.0, self.anisotropy_strength == 0.0) {
            (true, _) => 1.0,
            (_, true) => albedo::mirror_average(self.roughness),
            _ => albedo::anisotropic_mirror_average(self.roughness, self.anisotropy_strength),
        }
    }

    /// Colour of what a metal has scattered more than once (Kulla and Conty 2017).
    pub fn rest_colour(&self, f0: Vec3) -> Vec3 {
        let (reflected, lost) = (fresnel::schlick_average(f0), self.loss_average());
        reflected * reflected * (1.0 - lost) / (1.0 - reflected * lost)
    }
}

/// Losses under this need no lobe to make up for them, and cannot be divided by.
pub(super) const LEAST_LOSS: f32 = 1e-5;

/// The interface of the dielectric part of the base.
#[derive(Debug, Clone)]
pub(super) struct Dielectric {
    /// Index of refraction on the far side divided by that on the view's.
    pub eta: f32,
    mirror: RoughMirror,
    /// Reflectance at normal and at grazing incidence.
    f0: Vec3,
    f90: f32,
    /// Of the exact Fresnel term.
    exact_f0: f32,
}

/// How what one scattering at a transmitting interface loses is shared among two lobes that make up for it.
pub(super) struct LossShares {
    /// Of the lobe on the view's side, and the mean loss there.
    pub reflected: f32,
    pub near_average: f32,
    /// Of the lobe on the other side, and the mean loss there.
    pub transmitted: f32,
    pub far_average: f32,
}

impl Dielectric {
    /// KHR_materials_ior, _specular and _iridescence; from inside a volume, the plain interface.
    pub fn new(p: &Parameters, mirror: RoughMirror, view_cosine: f32, inside: bool) -> Self {
        // Zero stands for a reflectance of the specular colour alone; its angular dependence is the default's.
        let eta = if p.ior == 0.0 { 1.5 } else { p.ior };
        let exact_f0 = fresnel::dielectric_f0(eta);
        if inside {
            return Self { eta: 1.0 / eta, mirror, f0: Vec3::splat(exact_f0), f90: 1.0, exact_f0 };
        }
        let f0 = if p.ior == 0.0 { 1.0 } else { exact_f0 };
        let f0 = (f0 * p.specular_colour).min(Vec3::ONE) * p.specular;
        let mut interface = Self { eta, mirror, f0, f90: p.specular, exact_f0 };
        if p.iridescence > 0.0 {
            let film = fresnel::thin_film(view_cosine, p.iridescence_ior, p.iridescence_thickness_nm, f0);
            let seen = interface.reflectance(view_cosine).lerp(film, p.iridescence);
            interface.f90 += (1.0 - interface.f90) * p.iridescence;
            interface.f0 = at_normal_incidence(seen, interface.f90, interface.weight(view_cosine));
        }
        interface
    }

    /// How far reflectance has come from that at normal to that at grazing incidence, by the exact Fresnel term.
    fn weight(&self, cosine: f32) -> f32 {
        (fresnel::dielectric(cosine, self.eta) - self.exact_f0) / (1.0 - self.exact_f0)
    }

    /// Reflectance of the microfacets.
    pub fn reflectance(&self, cosine: f32) -> Vec3 {
        self.f0 + (self.f90 - self.f0) * self.weight(cosine)
    }

    /// Share of light that the interface reflects; of a coloured one, the largest of the channels, so that what lies below
    /// does not take the complementary colour (KHR_materials_specular).
    pub fn albedo(&self, direction: Vec3) -> f32 {
        if self.mirror.roughness == 0.0 {
            return self.reflectance(direction.z).max_element();
        }
        let exact = albedo::dielectric(direction.z, self.mirror.roughness, self.eta).x;
        self.scaled(exact, 1.0 - self.mirror.loss(direction))
    }

    /// The mean of [`Self::albedo`] over all directions, weighted by their cosine.
    pub fn albedo_average(&self) -> f32 {
        if self.mirror.roughness == 0.0 {
            return self.scaled(fresnel::dielectric_average(self.eta), 1.0);
        }
        let exact = albedo::dielectric_average(self.mirror.roughness, self.eta).x;
        self.scaled(exact, 1.0 - self.mirror.loss_average())
    }

    /// The albedo between the specular extension's ends, from that of the exact interface and that of a white mirror.
    fn scaled(&self, exact: f32, mirror: f32) -> f32 {
        let f0 = self.f0.max_element();
        f0 * mirror + (self.f90 - f0) * (exact - self.exact_f0 * mirror) / (1.0 - self.exact_f0)
    }

    /// Share of light that is lost after one scattering in a direction on the view's side or, where `beyond`, on the other.
    pub fn loss(&self, direction: Vec3, is_thin: bool, beyond: bool) -> f32 {
        if is_thin {
            return self.mirror.loss(direction);
        }
        let eta = if beyond { 1.0 / self.eta } else { self.eta };
        (1.0 - albedo::dielectric(direction.z, self.mirror.roughness, eta).element_sum()).max(0.0)
    }

    /// `None` where nothing is lost, or nothing that is known: refraction at anisotropic microfacets is not tabulated.
    ///
    /// The shares follow from the mean Fresnel terms, whose ratio across the interface makes transmission reciprocal (Kulla
    /// and Conty 2017).
    pub fn loss_shares(&self, is_thin: bool) -> Option<LossShares> {
        let (near_average, far_average) = if is_thin {
            (self.mirror.loss_average(), self.mirror.loss_average())
        } else if self.mirror.anisotropy_strength > 0.0 {
            return None;
        } else {
            let average = |eta| 1.0 - albedo::dielectric_average(self.mirror.roughness, eta).element_sum();
            (average(self.eta), average(1.0 / self.eta))
        };
        let transmitted = (1.0 - fresnel::dielectric_average(self.eta)) * (far_average / near_average).min(1.0);
        let is_lossy = near_average > LEAST_LOSS && far_average > LEAST_LOSS;
        is_lossy.then_some(LossShares { reflected: 1.0 - transmitted, near_average, transmitted, far_average })
    }
}
