//! PNG pictures of probes, for people: an unfolded cube per probe and one sheet of all of them.
//!
//! The cross shows the cube from inside, looking along -Z in its centre. No face is turned or mirrored:
//!
//! ```text
//!      +Y
//!  -X  -Z  +X  +Z
//!      -Y
//! ```

use std::io::Write;
use std::path::Path;

use glam::Vec3;
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ImageError, Rgba, RgbaImage};

use super::file::write_bytes_atomically;
use crate::bake::Cubemap;
use crate::error::Result;
use crate::scene::colour::linear_to_srgb;
use crate::trace::Face;

/// Largest edge of a face in a probe's preview, in pixels; larger faces are averaged down.
pub const PREVIEW_FACE_SIZE: u32 = 256;

/// Largest edge of a face on a contact sheet, in pixels.
pub const SHEET_FACE_SIZE: u32 = 32;

/// Largest width and height of a contact sheet, in pixels.
pub const SHEET_EDGE: u32 = 4096;

/// Columns and rows of a cross, in faces.
const CROSS: [u32; 2] = [4, 3];

/// Column and row of each face in the cross.
const CROSS_CELLS: [(Face, [u32; 2]); 6] = [
    (Face::PosX, [2, 1]),
    (Face::NegX, [0, 1]),
    (Face::PosY, [1, 0]),
    (Face::NegY, [1, 2]),
    (Face::PosZ, [3, 1]),
    (Face::NegZ, [1, 1]),
];

/// The unfolded cube, sRGB-encoded and clamped to [0, 1]; opaque in the faces and transparent between them.
pub fn cross(cubemap: &Cubemap) -> RgbaImage {
    let face_size = cubemap.face_size.min(PREVIEW_FACE_SIZE);
    let mut image = RgbaImage::new(CROSS[0] * face_size, CROSS[1] * face_size);
    draw_cross(&mut image, [0, 0], face_size, cubemap);
    image
}

/// Small crosses of all probes of a bake, row by row in the order of their indices.
#[derive(Debug, Clone)]
pub struct ContactSheet {
    image: RgbaImage,
    columns: u32,
    face_size: u32,
}

impl ContactSheet {
    /// An empty sheet for `probes` probes whose cubemaps have faces of `face_size` texels. Crosses shrink with the number
    /// of probes, so that the sheet stays within [`SHEET_EDGE`]; at a pixel per face, a million probes fit.
    pub fn new(probes: u32, face_size: u32) -> Self {
        // As many columns as make the sheet about square.
        let columns = ((f64::from(probes) * f64::from(CROSS[1]) / f64::from(CROSS[0])).sqrt().ceil() as u32).max(1);
        let rows = probes.div_ceil(columns).max(1);
        let fitting = (SHEET_EDGE / (CROSS[0] * columns)).min(SHEET_EDGE / (CROSS[1] * rows));
        let face_size = face_size.min(SHEET_FACE_SIZE).min(fitting).max(1);
        let image = RgbaImage::new(columns * CROSS[0] * face_size, rows * CROSS[1] * face_size);
        Self { image, columns, face_size }
    }

    /// Draws the [`thumbnail`] of the probe with this index. The order of calls does not matter.
    pub fn draw(&mut self, index: u32, cubemap: &Cubemap) {
        let cell = [index % self.columns, index / self.columns];
        let corner = [0, 1].map(|axis| cell[axis] * CROSS[axis] * self.face_size);
        draw_cross(&mut self.image, corner, self.face_size, cubemap);
    }

    /// Adds what is drawn on `other` to `sheet`; false if they are not of one size. What is not drawn is transparent.
    pub fn overlay(sheet: &mut RgbaImage, other: &RgbaImage) -> bool {
        if sheet.dimensions() != other.dimensions() {
            return false;
        }
        for (pixel, drawn) in sheet.pixels_mut().zip(other.pixels()) {
            if drawn.0[3] > 0 {
                *pixel = *drawn;
            }
        }
        true
    }

    /// The sheet as drawn so far.
    pub fn image(&self) -> &RgbaImage {
        &self.image
    }
}

/// A cubemap with faces as large as on a contact sheet of few probes.
pub fn thumbnail(cubemap: &Cubemap) -> Cubemap {
    let (from, to) = (cubemap.face_size, cubemap.face_size.min(SHEET_FACE_SIZE));
    let faces = Face::ALL.into_iter().flat_map(|face| (0..to * to).map(move |i| (face, i % to, i / to)));
    let texel = |(face, x, y)| mean_of_block(cubemap.face(face), from, to, x, y).extend(1.0).to_array();
    Cubemap { face_size: to, texels: faces.map(texel).collect(), distance: None }
}

/// Draws a cross with its top left at `corner`. `face_size` is at most the cubemap's.
fn draw_cross(image: &mut RgbaImage, corner: [u32; 2], face_size: u32, cubemap: &Cubemap) {
    for (face, [column, row]) in CROSS_CELLS {
        let (left, top) = (corner[0] + column * face_size, corner[1] + row * face_size);
        for (x, y) in (0..face_size).flat_map(|y| (0..face_size).map(move |x| (x, y))) {
            let linear = mean_of_block(cubemap.face(face), cubemap.face_size, face_size, x, y);
            let [r, g, b] = linear.to_array().map(display_byte);
            image.put_pixel(left + x, top + y, Rgba([r, g, b, 255]));
        }
    }
}

/// Mean linear colour of the texels under pixel (`x`, `y`) when a face is reduced to `reduced_size` pixels.
fn mean_of_block(face: &[[f32; 4]], face_size: u32, reduced_size: u32, x: u32, y: u32) -> Vec3 {
    let range = |i: u32| (i * face_size / reduced_size) as usize..((i + 1) * face_size / reduced_size) as usize;
    let (rows, columns) = (range(y), range(x));
    let count = rows.len() * columns.len();
    let texels = rows.flat_map(|row| &face[row * face_size as usize..][columns.clone()]);
    texels.map(|texel| Vec3::from_slice(&texel[..3])).sum::<Vec3>() / count as f32
}

fn display_byte(linear: f32) -> u8 {
    (linear_to_srgb(linear).clamp(0.0, 1.0) * 255.0).round() as u8
}

/// Writes a PNG; the same image gives the same bytes. Fails with [`crate::Error::Write`].
pub fn write_png(path: &Path, image: &RgbaImage) -> Result<()> {
    write_bytes_atomically(path, |writer| writer.write_all(&png_bytes(image)?))
}

/// The bytes of a PNG.
pub fn png_bytes(image: &RgbaImage) -> std::io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    let encoder = PngEncoder::new_with_quality(&mut bytes, CompressionType::Fast, FilterType::Adaptive);
    image.write_with_encoder(encoder).map_err(|error| match error {
        ImageError::IoError(source) => source,
        other => std::io::Error::other(other),
    })?;
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::colour::srgb_to_linear;

    /// Linear colour of a texel: (d + 1) / 2 of the unit direction through its centre.
    fn direction_coded(face_size: u32) -> Cubemap {
        let texel = |face: Face, i: u32| {
            let (x, y) = (f64::from(i % face_size) + 0.5, f64::from(i / face_size) + 0.5);
            ((face.direction(face_size, x, y).normalize() + 1.0) / 2.0).as_vec3().extend(1.0).to_array()
        };
        let texels =
            Face::ALL.into_iter().flat_map(|face| (0..face_size.pow(2)).map(move |i| texel(face, i))).collect();
        Cubemap { face_size, texels, distance: None }
    }

    fn direction_at(image: &RgbaImage, x: u32, y: u32) -> Vec3 {
        let Rgba([r, g, b, a]) = *image.get_pixel(x, y);
        assert_eq!(a, 255);
        Vec3::from_array([r, g, b].map(|byte| srgb_to_linear(f32::from(byte) / 255.0))) * 2.0 - 1.0
    }

    #[test]
    fn faces_that_touch_in_the_cross_show_neighbouring_directions() {
        let n = 64;
        let image = cross(&direction_coded(n));
        assert_eq!(image.dimensions(), (4 * n, 3 * n));
        let pairs = [([0, 1], [1, 1]), ([1, 1], [2, 1]), ([2, 1], [3, 1]), ([1, 0], [1, 1]), ([1, 1], [1, 2])];
        for ([left, top], [right, bottom]) in pairs {
            for i in 0..n {
                let (a, b) = if left == right {
                    ((left * n + i, bottom * n - 1), (left * n + i, bottom * n))
                } else {
                    ((right * n - 1, top * n + i), (right * n, top * n + i))
                };
                let step = direction_at(&image, a.0, a.1).distance(direction_at(&image, b.0, b.1));
                // A texel is 2/64 of a face at most, and 8 bits add their rounding.
                assert!(step < 0.06, "{a:?} to {b:?}: {step}");
            }
        }
        // The ends of the row close the ring.
        for y in n..2 * n {
            assert!(direction_at(&image, 0, y).distance(direction_at(&image, 4 * n - 1, y)) < 0.06);
        }
    }

    #[test]
    fn no_face_of_the_cross_is_mirrored_or_upside_down() {
        let n = 64;
        let image = cross(&direction_coded(n));
        for (face, [column, row]) in CROSS_CELLS {
            let at = |x: u32, y: u32| direction_at(&image, column * n + x, row * n + y);
            let (right, up) = (at(60, 32) - at(3, 32), at(32, 3) - at(32, 60));
            let look = at(32, 32);
            assert!(look.dot(face.axes()[2].as_vec3()) > 0.99, "{face:?}");
            assert!(look.cross(up).dot(right) > 1.0, "{face:?} is mirrored");
            if row == 1 {
                assert!(up.y > 1.0, "{face:?} is not upright");
            }
        }
    }

    #[test]
    fn pixels_between_the_faces_are_transparent() {
        let image = cross(&direction_coded(8));
        let opaque = image.pixels().filter(|pixel| pixel[3] == 255).count();
        let transparent = image.pixels().filter(|pixel| pixel[3] == 0).count();
        assert_eq!((opaque, transparent), (6 * 64, 6 * 64));
    }

    #[test]
    fn colours_are_encoded_and_clamped() {
        assert_eq!([-1.0, 0.0, 0.214_041_14, 1.0, 9.0, f32::INFINITY].map(display_byte), [0, 0, 128, 255, 255, 255]);
    }

    #[test]
    fn large_faces_are_averaged_in_linear_light() {
        let face_size = PREVIEW_FACE_SIZE * 2;
        // A checkerboard of black and white texels is mid grey in linear light: sRGB 188.
        let texel = |i: u32| if (i % face_size + i / face_size).is_multiple_of(2) { [1.0; 4] } else { [0.0; 4] };
        let texels = (0..6 * face_size.pow(2)).map(texel).collect();
        let image = cross(&Cubemap { face_size, texels, distance: None });
        assert_eq!(image.dimensions(), (4 * PREVIEW_FACE_SIZE, 3 * PREVIEW_FACE_SIZE));
        assert!(image.pixels().filter(|pixel| pixel[3] == 255).all(|pixel| pixel.0 == [188, 188, 188, 255]));
    }

    #[test]
    fn a_contact_sheet_stays_within_its_size_for_any_number_of_probes() {
        for probes in [0, 1, 2, 7, 125, 1000, 99_999, 1_000_000] {
            let (width, height) = ContactSheet::new(probes, 256).image.dimensions();
            assert!(width <= SHEET_EDGE && height <= SHEET_EDGE, "{probes}: {width} x {height}");
            let cells = (width / CROSS[0]) * (height / CROSS[1]);
            assert!(cells >= probes, "{probes}");
        }
    }

    #[test]
    fn a_contact_sheet_shows_each_probe_in_its_own_cell() {
        let mut sheet = ContactSheet::new(5, 4);
        let solid = |value| Cubemap { face_size: 4, texels: vec![[value; 4]; 6 * 16], distance: None };
        for (index, value) in [(4, 0.2), (0, 0.4), (3, 0.6), (1, 0.8), (2, 1.0)] {
            sheet.draw(index, &solid(value));
        }
        let (columns, rows) = (sheet.columns, 5_u32.div_ceil(sheet.columns));
        assert_eq!(sheet.image.dimensions(), (columns * 16, rows * 12));
        for (index, value) in [(0, 0.4), (1, 0.8), (2, 1.0), (3, 0.6), (4, 0.2)] {
            // The middle of the -Z face of the probe's cross.
            let pixel = sheet.image().get_pixel(index % columns * 16 + 6, index / columns * 12 + 6);
            assert_eq!(pixel[0], display_byte(value), "probe {index}");
        }
    }

    #[test]
    fn a_png_comes_back_and_its_bytes_are_the_same_each_time() {
        let folder = tempfile::tempdir().unwrap();
        let image = cross(&direction_coded(16));
        let [a, b] = ["a.png", "b.png"].map(|name| folder.path().join(name));
        write_png(&a, &image).unwrap();
        write_png(&b, &image).unwrap();
        assert!(std::fs::read(&a).unwrap() == std::fs::read(&b).unwrap());
        assert_eq!(image::open(&a).unwrap().into_rgba8(), image);
    }
}
