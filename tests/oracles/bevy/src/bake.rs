//! What is seen in a bake, computed on the CPU: from the manifest and the bake's own cube maps, or from the exported ones.

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
    /// Of the bake and of the export: the first and the last mip of prefiltered radiance, of roughness 0 and 1, and
    /// irradiance over pi.
    maps: [[CubeMap; 3]; 2],
}

/// Whose maps.
#[derive(Clone, Copy)]
pub enum Source {
    Bake,
    Export,
}

/// Which of a probe's maps.
#[derive(Clone, Copy)]
pub enum Map {
    Sharp,
    Rough,
    Irradiance,
}

pub fn probes(bake: &Path, export: &Path) -> Vec<Probe> {
    let manifest: Value = serde_json::from_slice(&std::fs::read(bake.join("manifest.json")).unwrap()).unwrap();
    let vector = |value: &Value| DVec3::from_array([0, 1, 2].map(|axis| value[axis].as_f64().unwrap()));
    let sides = |value: &Value| [vector(&value["min"]), vector(&value["max"])];
    let probe = |record: &Value| {
        let influence = &record["influence"];
        let blend = [0, 2, 4].map(|low| [low, low + 1].map(|side| influence["blend"][side].as_f64().unwrap()));
        let files = record["files"].as_array().unwrap();
        let id = record["id"].as_str().unwrap();
        let baked = |role: &str| {
            let file = files.iter().find(|file| file["role"] == role && file["format"] == "ktx2").unwrap();
            mips(&bake.join(file["path"].as_str().unwrap()))
        };
        let exported = |name: &str| mips(&export.join(format!("assets/splatprobe/{id}/{name}.ktx2")));
        let maps = |[first, last]: [CubeMap; 2], [irradiance, _]: [CubeMap; 2]| [first, last, irradiance];
        assert_eq!((&record["proxy"]["min"], &record["proxy"]["max"]), (&influence["min"], &influence["max"]));
        Probe {
            id: id.to_owned(),
            position: vector(&record["position"]),
            proxy: sides(&record["proxy"]),
            influence: sides(influence),
            blend: DVec3::from_array(blend.map(|[low, high]| (low + high) / 2.0)),
            maps: [maps(baked("specular"), baked("irradiance")), maps(exported("specular"), exported("diffuse"))],
        }
    };
    manifest["probes"].as_array().unwrap().iter().map(probe).collect()
}

impl Probe {
    /// Where the exporter need not resample.
    pub fn is_in_the_middle_of_a_cube(&self) -> bool {
        let [min, max] = self.proxy;
        let size = (max - min).x;
        ((min + max) / 2.0).distance(self.position) < 1e-3 * size
            && (max - min).distance(DVec3::splat(size)) < 1e-3 * size
    }

    /// As light_probe.wgsl has it: a ramp at each side of the box, the least of the axes.
    fn weight(&self, position: DVec3) -> f64 {
        let [min, max] = self.influence;
        let inside = (position - min).min(max - position);
        (inside / self.blend.max(1e-4 * (max - min))).clamp(DVec3::ZERO, DVec3::ONE).min_element()
    }

    /// What a ray from inside the proxy box, which is what the bake says it hits, looks up.
    fn look_up(&self, source: Source, map: Map, position: DVec3, direction: DVec3) -> DVec3 {
        let [min, max] = self.proxy;
        let exits = DVec3::select(direction.cmpgt(DVec3::ZERO), max - position, min - position) / direction;
        let hit = position + direction * exits.min_element();
        let toward = match source {
            Source::Bake => hit - self.position,
            // environment_map.wgsl: as seen from the box's middle in its scaled space, z negated.
            Source::Export => (hit - (min + max) / 2.0) / (max - min) * DVec3::new(1.0, 1.0, -1.0),
        };
        self.maps[source as usize][map as usize].look_up(toward)
    }
}

/// Light by direction from several probes at once, as Bevy blends them: by their weights, which need not sum to 1.
pub fn look_up(probes: &[Probe], source: Source, map: Map, position: DVec3, direction: DVec3) -> DVec3 {
    let (mut sum, mut total) = (DVec3::ZERO, 0.0);
    for probe in probes {
        let weight = probe.weight(position);
        if weight > 0.0 {
            sum += probe.look_up(source, map, position, direction) * weight;
            total += weight;
        }
    }
    sum / total
}

/// A mip of a KTX2 cube map of half floats.
#[derive(Clone)]
struct CubeMap {
    size: usize,
    texels: Vec<DVec3>,
}

/// The first and the last.
fn mips(path: &Path) -> [CubeMap; 2] {
    let bytes = std::fs::read(path).unwrap();
    let reader = ktx2::Reader::new(&bytes[..]).unwrap();
    let header = reader.header();
    assert_eq!(header.format, Some(ktx2::Format::R16G16B16A16_SFLOAT));
    let half = |two: &[u8]| f64::from(f16::from_le_bytes([two[0], two[1]]));
    let mut mips = reader.levels().enumerate().map(|(i, level)| {
        let mut data = Vec::new();
        ruzstd::decoding::StreamingDecoder::new(level.data).unwrap().read_to_end(&mut data).unwrap();
        let texels = data.chunks(8).map(|texel| DVec3::new(half(texel), half(&texel[2..]), half(&texel[4..])));
        CubeMap { size: (header.pixel_width >> i) as usize, texels: texels.collect() }
    });
    let first = mips.next().unwrap();
    let last = mips.last().unwrap_or_else(|| first.clone());
    [first, last]
}

impl CubeMap {
    /// Bilinear, across the edges of faces too.
    fn look_up(&self, direction: DVec3) -> DVec3 {
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
