//! A bake as its manifest and its own cube maps have it, and what a mirror ball in it shows, computed on the CPU without the
//! exporter's files.

use std::io::Read;
use std::path::Path;

use bevy::math::{DVec2, DVec3};
use half::f16;
use serde_json::Value;

pub struct Probe {
    pub id: String,
    pub position: DVec3,
    pub proxy: [DVec3; 2],
    influence: [DVec3; 2],
    /// Mean of both sides' blend distances.
    blend: DVec3,
    cube: CubeMap,
}

pub fn probes(bake: &Path) -> Vec<Probe> {
    let manifest: Value = serde_json::from_slice(&std::fs::read(bake.join("manifest.json")).unwrap()).unwrap();
    let vector = |value: &Value| DVec3::from_array([0, 1, 2].map(|axis| value[axis].as_f64().unwrap()));
    let sides = |value: &Value| [vector(&value["min"]), vector(&value["max"])];
    let probe = |record: &Value| {
        let influence = &record["influence"];
        let blend = [0, 2, 4].map(|low| [low, low + 1].map(|side| influence["blend"][side].as_f64().unwrap()));
        let files = record["files"].as_array().unwrap();
        let specular = files.iter().find(|file| file["role"] == "specular" && file["format"] == "ktx2").unwrap();
        Probe {
            id: record["id"].as_str().unwrap().to_owned(),
            position: vector(&record["position"]),
            proxy: sides(&record["proxy"]),
            influence: sides(influence),
            blend: DVec3::from_array(blend.map(|[low, high]| (low + high) / 2.0)),
            cube: CubeMap::new(&bake.join(specular["path"].as_str().unwrap())),
        }
    };
    manifest["probes"].as_array().unwrap().iter().map(probe).collect()
}

impl Probe {
    /// As light_probe.wgsl has it: a ramp at each side of the box, the least of the axes.
    fn weight(&self, position: DVec3) -> f64 {
        let [min, max] = self.influence;
        let inside = (position - min).min(max - position);
        (inside / self.blend.max(1e-4 * (max - min))).clamp(DVec3::ZERO, DVec3::ONE).min_element()
    }

    /// Radiance along a ray from inside the proxy box, which is what the bake says it hits.
    fn radiance(&self, position: DVec3, direction: DVec3) -> DVec3 {
        let [min, max] = self.proxy;
        let exits = DVec3::select(direction.cmpgt(DVec3::ZERO), max - position, min - position) / direction;
        self.cube.radiance(position + direction * exits.min_element() - self.position)
    }
}

/// Light by direction from several probes at once, as Bevy blends them: by their weights, which need not sum to 1.
pub fn radiance(probes: &[Probe], position: DVec3, direction: DVec3) -> DVec3 {
    let (mut sum, mut total) = (DVec3::ZERO, 0.0);
    for probe in probes {
        let weight = probe.weight(position);
        if weight > 0.0 {
            sum += probe.radiance(position, direction) * weight;
            total += weight;
        }
    }
    sum / total
}

/// Mip 0 of a KTX2 cube map of half floats.
struct CubeMap {
    size: usize,
    texels: Vec<DVec3>,
}

impl CubeMap {
    fn new(path: &Path) -> Self {
        let bytes = std::fs::read(path).unwrap();
        let reader = ktx2::Reader::new(&bytes[..]).unwrap();
        assert_eq!(reader.header().format, Some(ktx2::Format::R16G16B16A16_SFLOAT));
        let mut data = Vec::new();
        let level = reader.levels().next().unwrap().data;
        ruzstd::decoding::StreamingDecoder::new(level).unwrap().read_to_end(&mut data).unwrap();
        let half = |two: &[u8]| f64::from(f16::from_le_bytes([two[0], two[1]]));
        let texels = data.chunks(8).map(|texel| DVec3::new(half(texel), half(&texel[2..]), half(&texel[4..])));
        Self { size: reader.header().pixel_width as usize, texels: texels.collect() }
    }

    /// Bilinear, across the edges of faces too.
    fn radiance(&self, direction: DVec3) -> DVec3 {
        let (slot, place) = locate(direction);
        let place = place * self.size as f64 - 0.5;
        let (corner, share) = (place.floor(), place - place.floor());
        let row = |y: f64| {
            let at = |x: f64| self.texel(slot, corner + DVec2::new(x, y));
            at(0.0).lerp(at(1.0), share.x)
        };
        row(0.0).lerp(row(1.0), share.y)
    }

    fn texel(&self, slot: usize, corner: DVec2) -> DVec3 {
        let size = self.size as f64;
        // Through the texel's middle: beyond an edge lies the neighbour's nearest texel.
        let (slot, place) = locate(through(slot, (corner + 0.5) / size * 2.0 - 1.0));
        let [x, y] = (place * size).to_array().map(|index| (index as usize).min(self.size - 1));
        self.texels[(slot * self.size + y) * self.size + x]
    }
}

/// OpenGL 4.6, table 8.19: slot and the place in it, 0 to 1, by direction.
fn locate(v: DVec3) -> (usize, DVec2) {
    let [x, y, z] = v.to_array();
    let [ax, ay, az] = v.abs().to_array();
    let (slot, s, t, major) = if ax >= ay && ax >= az {
        if x > 0.0 { (0, -z, -y, ax) } else { (1, z, -y, ax) }
    } else if ay >= az {
        if y > 0.0 { (2, x, z, ay) } else { (3, x, -z, ay) }
    } else {
        if z > 0.0 { (4, x, -y, az) } else { (5, -x, -y, az) }
    };
    (slot, (DVec2::new(s, t) / major + 1.0) / 2.0)
}

/// A direction through a place of a slot, -1 to 1.
fn through(slot: usize, place: DVec2) -> DVec3 {
    let [s, t] = place.to_array();
    let [x, y, z] = [[1.0, -t, -s], [-1.0, -t, s], [s, 1.0, t], [s, -1.0, -t], [s, -t, 1.0], [-s, -t, -1.0]][slot];
    DVec3::new(x, y, z)
}
