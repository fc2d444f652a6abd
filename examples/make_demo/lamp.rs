//! A lamp on a picture stand, as binary glTF 2.0: one part per kind of material that a bake must get right.
//!
//! The picture (unlit, textured) shows which way is up and that nothing is mirrored; the bulb is emissive with a
//! strength above 1; the shade around it is a MASK with round holes; the pane beside the picture is a BLEND.

use std::f32::consts::{PI, TAU};
use std::io::Cursor;

use glam::{Vec2, Vec3};
use image::{ImageFormat, Rgba, RgbaImage};
use serde_json::{Value, json};

/// The whole file.
pub fn glb() -> Vec<u8> {
    let mut file = Buffer::default();
    let nodes = [
        ("stand", 0, Surface::cuboid(Vec3::new(-0.42, 0.0, -0.12), Vec3::new(0.42, 0.04, 0.12))),
        ("post", 0, Surface::cuboid(Vec3::new(-0.015, 0.04, -0.045), Vec3::new(0.015, 1.12, -0.015))),
        ("picture", 1, Surface::quad(Vec3::new(-0.4, 0.25, 0.0), Vec3::X * 0.5, Vec3::Y * 0.5)),
        ("bulb", 2, Surface::sphere(Vec3::new(0.0, 1.2, -0.03), 0.08)),
        ("shade", 3, Surface::tube(Vec3::new(0.0, 1.05, -0.03), 0.17, 0.3)),
        ("pane", 4, Surface::quad(Vec3::new(0.13, 0.25, 0.0), Vec3::X * 0.27, Vec3::Y * 0.5)),
    ];
    let meshes: Vec<Value> =
        nodes.iter().map(|(name, material, surface)| file.mesh(name, *material, surface)).collect();
    let images = [("picture", picture()), ("holes", holes())].map(|(name, image)| file.image(name, &image));
    let root = json!({
        "asset": { "version": "2.0", "generator": "splatprobe make_demo" },
        "scene": 0,
        "scenes": [{ "name": "lamp", "nodes": (0..nodes.len()).collect::<Vec<_>>() }],
        "nodes": nodes.iter().enumerate().map(|(i, n)| json!({ "name": n.0, "mesh": i })).collect::<Vec<_>>(),
        "meshes": meshes,
        "materials": materials(),
        "textures": [{ "source": 0, "sampler": 0 }, { "source": 1, "sampler": 0 }],
        "samplers": [{}],
        "images": images,
        "extensionsUsed": ["KHR_materials_emissive_strength", "KHR_materials_unlit"],
        "accessors": file.accessors,
        "bufferViews": file.views,
        "buffers": [{ "byteLength": file.bytes.len() }],
    });
    container(root.to_string().into_bytes(), file.bytes)
}

fn materials() -> Value {
    let unlit = json!({ "KHR_materials_unlit": {} });
    json!([
        { "name": "wood", "pbrMetallicRoughness": { "baseColorFactor": [0.25, 0.13, 0.06, 1.0] }, "extensions": unlit },
        { "name": "picture", "pbrMetallicRoughness": { "baseColorTexture": { "index": 0 } }, "doubleSided": true,
          "extensions": unlit },
        { "name": "bulb", "pbrMetallicRoughness": { "baseColorFactor": [0.0, 0.0, 0.0, 1.0] },
          "emissiveFactor": [1.0, 0.75, 0.4],
          "extensions": { "KHR_materials_emissive_strength": { "emissiveStrength": 8.0 } } },
        { "name": "shade", "pbrMetallicRoughness": { "baseColorTexture": { "index": 1 } }, "alphaMode": "MASK",
          "alphaCutoff": 0.5, "doubleSided": true, "extensions": unlit },
        { "name": "pane", "pbrMetallicRoughness": { "baseColorFactor": [0.05, 0.3, 0.6, 0.4] }, "alphaMode": "BLEND",
          "doubleSided": true, "extensions": unlit },
    ])
}

/// A GLB container around its two chunks.
fn container(mut json: Vec<u8>, mut binary: Vec<u8>) -> Vec<u8> {
    json.resize(json.len().next_multiple_of(4), b' ');
    binary.resize(binary.len().next_multiple_of(4), 0);
    let total = 12 + 8 + json.len() + 8 + binary.len();
    let mut bytes = b"glTF".to_vec();
    bytes.extend([2, total as u32].map(u32::to_le_bytes).concat());
    for (kind, chunk) in [(b"JSON", json), (b"BIN\0", binary)] {
        bytes.extend((chunk.len() as u32).to_le_bytes());
        bytes.extend(kind);
        bytes.extend(chunk);
    }
    bytes
}

/// The binary chunk and what points into it.
#[derive(Default)]
struct Buffer {
    bytes: Vec<u8>,
    views: Vec<Value>,
    accessors: Vec<Value>,
}

impl Buffer {
    fn view(&mut self, bytes: &[u8]) -> usize {
        self.bytes.resize(self.bytes.len().next_multiple_of(4), 0);
        self.views.push(json!({ "buffer": 0, "byteOffset": self.bytes.len(), "byteLength": bytes.len() }));
        self.bytes.extend_from_slice(bytes);
        self.views.len() - 1
    }

    fn accessor(&mut self, bytes: &[u8], mut accessor: Value) -> usize {
        accessor["bufferView"] = self.view(bytes).into();
        self.accessors.push(accessor);
        self.accessors.len() - 1
    }

    fn mesh(&mut self, name: &str, material: usize, surface: &Surface) -> Value {
        let Surface { positions, normals, uvs, triangles } = surface;
        let low = positions.iter().copied().fold(Vec3::INFINITY, Vec3::min).to_array();
        let high = positions.iter().copied().fold(Vec3::NEG_INFINITY, Vec3::max).to_array();
        let floats = |kind: &str| json!({ "componentType": 5126, "count": positions.len(), "type": kind });
        let mut bounded = floats("VEC3");
        bounded["min"] = json!(low);
        bounded["max"] = json!(high);
        let indices = json!({ "componentType": 5123, "count": triangles.len() * 3, "type": "SCALAR" });
        json!({ "name": name, "primitives": [{
            "attributes": {
                "POSITION": self.accessor(bytemuck::cast_slice(positions), bounded),
                "NORMAL": self.accessor(bytemuck::cast_slice(normals), floats("VEC3")),
                "TEXCOORD_0": self.accessor(bytemuck::cast_slice(uvs), floats("VEC2")),
            },
            "indices": self.accessor(bytemuck::cast_slice(triangles), indices),
            "material": material,
        }] })
    }

    fn image(&mut self, name: &str, image: &RgbaImage) -> Value {
        let mut png = Cursor::new(Vec::new());
        image.write_to(&mut png, ImageFormat::Png).expect("a vector takes any number of bytes");
        json!({ "name": name, "mimeType": "image/png", "bufferView": self.view(png.get_ref()) })
    }
}

/// Vertices and counter-clockwise triangles.
#[derive(Default)]
struct Surface {
    positions: Vec<Vec3>,
    normals: Vec<Vec3>,
    uvs: Vec<Vec2>,
    triangles: Vec<[u16; 3]>,
}

impl Surface {
    /// A grid of `columns` by `rows` cells; `place` gives position and normal at (u, v), v downwards.
    fn grid(&mut self, columns: u16, rows: u16, place: impl Fn(Vec2) -> (Vec3, Vec3)) {
        let first = self.positions.len() as u16;
        for row in 0..=rows {
            for column in 0..=columns {
                let uv = Vec2::new(f32::from(column) / f32::from(columns), f32::from(row) / f32::from(rows));
                let (position, normal) = place(uv);
                self.positions.push(position);
                self.normals.push(normal);
                self.uvs.push(uv);
            }
        }
        for row in 0..rows {
            for column in 0..columns {
                let top = first + row * (columns + 1) + column;
                let below = top + columns + 1;
                self.triangles.extend([[top, below, below + 1], [top, below + 1, top + 1]]);
            }
        }
    }

    fn add_quad(&mut self, corner: Vec3, right: Vec3, up: Vec3) {
        let normal = right.cross(up).normalize();
        self.grid(1, 1, |uv| (corner + right * uv.x + up * (1.0 - uv.y), normal));
    }

    /// A rectangle from its lower left corner.
    fn quad(corner: Vec3, right: Vec3, up: Vec3) -> Self {
        let mut surface = Self::default();
        surface.add_quad(corner, right, up);
        surface
    }

    fn cuboid(low: Vec3, high: Vec3) -> Self {
        let [x, y, z] = {
            let size = high - low;
            [Vec3::X * size.x, Vec3::Y * size.y, Vec3::Z * size.z]
        };
        let mut surface = Self::default();
        let sides = [(low, y, x), (low + z, x, y), (low, z, y), (low + x, y, z), (low, x, z), (low + y, z, x)];
        for (corner, right, up) in sides {
            surface.add_quad(corner, right, up);
        }
        surface
    }

    fn sphere(centre: Vec3, radius: f32) -> Self {
        let mut surface = Self::default();
        surface.grid(24, 12, |uv| {
            let outward = around(uv.x) * (uv.y * PI).sin() + Vec3::Y * (uv.y * PI).cos();
            (centre + outward * radius, outward)
        });
        surface
    }

    /// An upright tube without ends, from the centre of its bottom.
    fn tube(foot: Vec3, radius: f32, height: f32) -> Self {
        let mut surface = Self::default();
        surface.grid(32, 1, |uv| {
            let outward = around(uv.x);
            (foot + outward * radius + Vec3::Y * (height * (1.0 - uv.y)), outward)
        });
        surface
    }
}

/// Unit vector in the ground plane, counter-clockwise seen from above.
fn around(turn: f32) -> Vec3 {
    Vec3::new((turn * TAU).sin(), 0.0, (turn * TAU).cos())
}

/// White letters "UP" over an arrow that points up, and an R at the right edge, on a red-green ramp.
fn picture() -> RgbaImage {
    const GLYPHS: [(&[&str], u32, u32); 4] = [
        (&["#...#", "#...#", "#...#", "#...#", "#...#", "#...#", ".###."], 3, 3),
        (&["####.", "#...#", "#...#", "####.", "#....", "#....", "#...."], 10, 3),
        (&["...#...", "..###..", ".#####.", "#######", "...#...", "...#...", "...#...", "...#...", "...#..."], 6, 14),
        (&["####.", "#...#", "#...#", "####.", "#.#..", "#..#.", "#...#"], 19, 14),
    ];
    const SCALE: u32 = 5;
    let edge = 26 * SCALE;
    let mut image = RgbaImage::from_fn(edge, edge, |x, y| {
        let border = x.min(y).min(edge - 1 - x).min(edge - 1 - y) < SCALE;
        let ramp = |t: u32| (40 + t * 150 / edge) as u8;
        if border { Rgba([20, 20, 20, 255]) } else { Rgba([ramp(x), ramp(edge - y), 60, 255]) }
    });
    for (rows, left, top) in GLYPHS {
        for (row, line) in (top..).zip(rows) {
            for (column, _) in (left..).zip(line.bytes()).filter(|(_, ink)| *ink == b'#') {
                for pixel in 0..SCALE * SCALE {
                    let [x, y] = [column * SCALE + pixel % SCALE, row * SCALE + pixel / SCALE];
                    image.put_pixel(x, y, Rgba([255; 4]));
                }
            }
        }
    }
    image
}

/// Cream paper with rows of round holes, whose alpha is 0.
fn holes() -> RgbaImage {
    RgbaImage::from_fn(256, 64, |x, y| {
        let [dx, dy] = [x % 16, y % 16].map(|offset| offset as f32 - 7.5);
        Rgba([240, 225, 190, if dx.hypot(dy) < 5.0 { 0 } else { 255 }])
    })
}
