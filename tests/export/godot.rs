//! Godot's view: ResourceImporterLayeredTexture for strips, sky shaders' samplerCube for directions, .tscn for scenes.

use std::path::Path;

use glam::DVec3;

use super::lookup::cube_texel;
use super::{Baked, Shown, exr};

/// Import with slices/arrangement 0, "1x6": X+ X- Y+ Y- Z+ Z- one below the other; texture(cube, direction) in Godot's world,
/// which is the manifest's frame.
pub fn shown(out: &Path, probe: &str) -> Shown {
    let import = std::fs::read_to_string(out.join(format!("{probe}.exr.import"))).unwrap();
    assert!(import.contains("importer=\"cubemap_texture\"") && import.contains("slices/arrangement=0\n"));
    let (n, pixels) = exr(&out.join(format!("{probe}.exr")));
    assert_eq!(pixels.len(), 6 * n * n);
    Box::new(move |direction| {
        let (slot, x, y) = cube_texel(direction, n);
        pixels[(slot * n + y) * n + x]
    })
}

/// The number in `name = 1.0` of a node's text.
fn number(node: &str, name: &str) -> f64 {
    node.lines().find_map(|line| line.strip_prefix(&format!("{name} = "))).unwrap().parse().unwrap()
}

/// The numbers in `name = Something(...)` of a node's text.
fn numbers(node: &str, name: &str) -> Vec<f64> {
    let line = node.lines().find_map(|line| line.strip_prefix(&format!("{name} = "))).unwrap();
    let inside = line.split(['(', ')']).nth(1).unwrap();
    inside.split(',').map(|number| number.trim().parse().unwrap()).collect()
}

#[test]
fn probes_capture_their_cubemaps_where_the_manifest_took_them() {
    let baked = Baked::with(|job| job.exposure = 1.0);
    let scene = std::fs::read_to_string(baked.export("godot").join("probes.tscn")).unwrap();
    assert!(scene.contains("metadata/exposure = 1\nmetadata/paper_white = 2\n"), "{scene}");
    assert!(scene.contains("[ext_resource type=\"Shader\" path=\"radiance.gdshader\" id=\"shader\"]"));
    let nodes: Vec<&str> = scene.split("\n[node ").skip(1).collect();
    for record in &baked.manifest.probes {
        let id = &record.id;
        assert!(scene.contains(&format!("[ext_resource type=\"Cubemap\" path=\"{id}.exr\" id=\"{id}\"]")));
        assert!(scene.contains(&format!("shader_parameter/radiance = ExtResource(\"{id}\")")));
        let at = nodes.iter().position(|node| node.starts_with(&format!("name=\"{id}\" type=\"ReflectionProbe\"")));
        let (probe, painted) = (nodes[at.unwrap()], nodes[at.unwrap() + 1]);
        let centre = DVec3::from_slice(&numbers(probe, "transform")[9..]);
        let offset = DVec3::from_slice(&numbers(probe, "origin_offset"));
        assert!((centre + offset - DVec3::from(record.position)).length() < 1e-9, "{probe}");
        // The painted box stands where the probe captures, on the only layer that it sees.
        assert!(painted.contains(&format!("parent=\"{id}\"")), "{painted}");
        assert_eq!(DVec3::from_slice(&numbers(painted, "transform")[9..]), offset);
        assert!(painted.contains("layers = 524288") && probe.contains("cull_mask = 524288"));
        assert!(painted.contains(&format!("material_override = SubResource(\"{id}\")")), "{painted}");
        let half = DVec3::from_slice(&numbers(probe, "size")) / 2.0;
        let (min, max) = (DVec3::from(record.influence.min), DVec3::from(record.influence.max));
        // One blend distance for all faces: the weight is full where it is in the manifest.
        let [px, nx, py, ny, pz, nz] = record.influence.blend;
        let full = half - number(probe, "blend_distance");
        assert!((centre - full - min - DVec3::new(nx, ny, nz)).length() < 1e-9, "{probe}");
        assert!((centre + full - max + DVec3::new(px, py, pz)).length() < 1e-9, "{probe}");
    }
}
