//! The light around a scene, from what the job says.

use std::path::Path;

use glam::Vec3;

use crate::encode::exr::read_exr;
use crate::job::Background;
use crate::scene::environment::EnvironmentMap;
use crate::scene::{LinearRgb, Scene};
use crate::{Error, Result};

/// Gives `scene` its background.
///
/// Fails with [`Error::Read`], [`Error::Invalid`] and [`Error::Unsupported`] where it is an image that cannot be read.
pub(super) fn set(scene: &mut Scene, background: &Background) -> Result<()> {
    match background {
        Background::Colour(colour) => scene.background = LinearRgb(Vec3::from(*colour)),
        Background::Map(path) => scene.environment = Some(read(path)?),
    }
    Ok(())
}

fn read(path: &Path) -> Result<EnvironmentMap> {
    let is = |extension: &str| path.extension().is_some_and(|found| found.eq_ignore_ascii_case(extension));
    let (width, height, texels) = if is("exr") {
        let image = read_exr(path)?;
        let channel = |name: &str| {
            let found = image.channels.get(name).or(image.channels.get("Y"));
            found.ok_or_else(|| Error::invalid(path, "channels", format!("there is no {name}")))
        };
        let (r, g, b) = (channel("R")?, channel("G")?, channel("B")?);
        let texels = r.iter().zip(g).zip(b).map(|((r, g), b)| Vec3::new(*r, *g, *b)).collect();
        (image.width, image.height, texels)
    } else if is("hdr") {
        let reader = image::ImageReader::open(path).map_err(|source| Error::read(path, source))?;
        let image = reader.decode().map_err(|error| Error::invalid(path, "image", error.to_string()))?.into_rgb32f();
        let texels = image.pixels().map(|pixel| Vec3::from(pixel.0)).collect();
        (image.width() as usize, image.height() as usize, texels)
    } else {
        return Err(Error::unsupported(path, "a background is a colour, or an .exr or .hdr image of all directions"));
    };
    if width != 2 * height {
        let what = format!("{width} x {height} pixels: an image of all directions is twice as wide as high");
        return Err(Error::invalid(path, "size", what));
    }
    EnvironmentMap::new(width, height, texels).ok_or_else(|| Error::invalid(path, "image", "it has no pixels"))
}
