//! A bake on disk, checked, as exporters read it.

use std::path::{Path, PathBuf};

use glam::{DVec3, Vec3};

use crate::encode::exr::read_exr;
use crate::filter::RgbCubemap;
use crate::manifest::{self, FileFormat, FileRecord, FileRole, Layout, Manifest, ProbeRecord, TexelSampling};
use crate::scene::Bounds;
use crate::trace::Face;
use crate::{Error, Result};

/// A bake whose files are what its manifest says.
pub struct Bake {
    folder: PathBuf,
    path: PathBuf,
    /// The manifest.
    pub manifest: Manifest,
}

impl Bake {
    /// Opens the bake at `path`, its folder or its manifest, and checks all of it.
    ///
    /// Fails with the first problem that [`manifest::verify`] finds, and where the bake has no probes or images, or probes
    /// that stand nowhere or whose ids cannot name files and objects.
    pub fn open(path: &Path) -> Result<Self> {
        let path = manifest::path_of(path);
        manifest::check(&path)?;
        let manifest = Manifest::read(&path)?;
        if manifest.probes.iter().all(|probe| probe.files.is_empty()) {
            return Err(Error::unsupported(path, "no images to export, only a placement: bake the job"));
        }
        for (i, probe) in manifest.probes.iter().enumerate() {
            check(probe).map_err(|(field, what)| Error::invalid(&path, format!("/probes/{i}/{field}"), what))?;
        }
        let folder = path.parent().unwrap_or(Path::new("")).to_owned();
        Ok(Self { folder, path, manifest })
    }

    /// The probe's radiance: of its strip, else of its six face files.
    ///
    /// Fails with [`Error::Unsupported`] when it has neither, and with the errors of [`read_exr`].
    pub fn cubemap(&self, probe: &ProbeRecord) -> Result<RgbCubemap> {
        let fits = |record: &&FileRecord, layout: Layout| {
            record.role == FileRole::Radiance
                && record.format == FileFormat::Exr
                && record.texel_sampling == TexelSampling::Center
                && record.layout == layout
        };
        if let Some(strip) = probe.files.iter().find(|record| fits(record, Layout::Strip)) {
            return self.cubemap_of(&[strip]);
        }
        let face = |face: Face| {
            let shows =
                |record: &&FileRecord| fits(record, Layout::Face) && record.face.as_deref() == Some(face.name());
            probe.files.iter().find(shows)
        };
        match Face::ALL.into_iter().map(face).collect::<Option<Vec<_>>>() {
            Some(faces) => self.cubemap_of(&faces),
            None => {
                let what = format!("probe {} has no cubemap as EXR: bake with the output strip or faces", probe.id);
                Err(Error::unsupported(&self.path, what))
            }
        }
    }

    /// The images in `records`, one below the other.
    fn cubemap_of(&self, records: &[&FileRecord]) -> Result<RgbCubemap> {
        let mut texels = Vec::new();
        for record in records {
            // The bake was checked, but files can change under way.
            let path = record.path_in(&self.folder).unwrap_or_else(|| self.path.clone());
            let image = read_exr(&path)?;
            let channel = |name: &str| {
                image.channels.get(name).ok_or_else(|| Error::invalid(&path, "header", format!("no channel {name}")))
            };
            let (r, g, b) = (channel("R")?, channel("G")?, channel("B")?);
            texels.extend(r.iter().zip(g).zip(b).map(|((&r, &g), &b)| Vec3::new(r, g, b)));
        }
        let size = records.first().map_or(0, |record| record.width);
        RgbCubemap::new(size, texels).map_err(|error| Error::invalid(&self.path, "images", error.to_string()))
    }
}

/// The probe's influence box.
pub fn influence(probe: &ProbeRecord) -> Bounds {
    Bounds { min: probe.influence.min.into(), max: probe.influence.max.into() }
}

/// The box with one blend distance for all faces, the greatest, in which the probe has its full weight exactly where it has
/// it in its influence box: faces that blend over less lie further out. For engines that know one distance only.
pub fn uniformly_blended(probe: &ProbeRecord) -> (Bounds, f64) {
    let blend = probe.influence.blend;
    let distance = blend.iter().copied().fold(0.0, f64::max);
    let outward = |side: usize| DVec3::from([0, 2, 4].map(|axis| distance - blend[axis + side]));
    let influence = influence(probe);
    (Bounds { min: influence.min - outward(1), max: influence.max + outward(0) }, distance)
}

/// Whether the proxy is nearly the influence box, so that engines which have one box for both can project reflections on it.
pub fn is_proxy_the_influence(probe: &ProbeRecord) -> bool {
    /// Distance between faces as a share of the proxy's edge: it moves the image on a wall by no more.
    const MOST: f64 = 0.1;
    let (influence, proxy) = (influence(probe), probe.proxy);
    let distance = (influence.min - proxy.min).abs().max((influence.max - proxy.max).abs());
    distance.cmple(proxy.extent() * MOST).all()
}

/// The field that is wrong and what is wrong with it.
fn check(probe: &ProbeRecord) -> std::result::Result<(), (&'static str, String)> {
    let is_name = |id: &str| {
        id.starts_with(|first: char| first.is_ascii_alphabetic())
            && id.len() <= 64
            && id.chars().all(|letter| letter.is_ascii_alphanumeric() || letter == '_')
    };
    if !is_name(&probe.id) {
        let what = format!("'{}' is no name: up to 64 of A-Z a-z 0-9 _, a letter first", probe.id);
        return Err(("id", what));
    }
    if !DVec3::from(probe.position).is_finite() {
        return Err(("position", "is not finite".into()));
    }
    for (field, bounds) in [("influence", influence(probe)), ("proxy", probe.proxy)] {
        if !(bounds.min.is_finite() && bounds.max.is_finite() && bounds.min.cmplt(bounds.max).all()) {
            return Err((field, "is not a box: every maximum must lie above its minimum, all finite".into()));
        }
    }
    if !probe.influence.blend.iter().all(|blend| blend.is_finite() && *blend >= 0.0) {
        return Err(("influence/blend", "must be 0 or more, and finite".into()));
    }
    Ok(())
}
