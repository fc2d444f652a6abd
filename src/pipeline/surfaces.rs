//! How light leaves the surfaces of a scene, as a job asks for it.

use std::sync::atomic::AtomicBool;

use glam::DVec3;

use super::plan::Loaded;
use super::trace_settings;
use crate::Result;
use crate::bake::Progress;
use crate::job::{Job, Order, Surface};
use crate::shade::path::SurfaceNoise;
use crate::shade::{LocallyLitSurfaces, PathSettings, PathSurfaces, UnlitSurfaces, local};
use crate::trace::{Surfaces, footprint};

/// The surfaces of a job's scene.
pub(crate) enum JobSurfaces<'a> {
    Unlit(UnlitSurfaces<'a>),
    Probe(LocallyLitSurfaces<'a>),
    Path(PathSurfaces<'a>),
}

impl<'a> JobSurfaces<'a> {
    /// Prepares the surfaces of `loaded`; contributions are blended in `order`, and `origins` are the probes, in metres
    /// relative to the scene origin. `progress` hears of what takes long; setting `cancel` ends it.
    pub fn new(
        job: &Job,
        order: Order,
        loaded: &'a Loaded,
        origins: &[DVec3],
        progress: &dyn Progress,
        cancel: &AtomicBool,
    ) -> Result<Self> {
        let Loaded { scene, bvh, .. } = loaded;
        let rays = job.face_size * job.samples;
        let ray_angle = footprint::ray_angle(rays);
        Ok(match job.surface {
            Surface::Unlit => Self::Unlit(UnlitSurfaces::new(&scene.meshes).for_rays_of(ray_angle)),
            Surface::Probe => {
                progress.stage("baking the cubemaps that light the meshes");
                let rules = trace_settings(job, order, local::FACE_SIZE);
                Self::Probe(LocallyLitSurfaces::new(scene, bvh, rules, cancel)?.for_rays_of(ray_angle))
            }
            Surface::Path => {
                let Job { noise, max_paths, .. } = *job;
                let settings = PathSettings { noise, max_paths, ..PathSettings::default() };
                let rules = trace_settings(job, order, rays);
                Self::Path(PathSurfaces::new(scene, bvh, rules, settings, origins).for_rays_of(ray_angle))
            }
        })
    }

    /// As tracers ask for them.
    pub fn as_dyn(&self) -> &dyn Surfaces {
        match self {
            Self::Unlit(surfaces) => surfaces,
            Self::Probe(surfaces) => surfaces,
            Self::Path(surfaces) => surfaces,
        }
    }

    /// How noisy the surfaces are that the probe at `origin` has asked for; `None` where none of them is lit by path tracing.
    pub fn noise_of(&self, origin: DVec3) -> Option<SurfaceNoise> {
        match self {
            Self::Path(surfaces) => surfaces.noise_of(origin),
            _ => None,
        }
    }
}
