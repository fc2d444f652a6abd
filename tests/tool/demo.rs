//! The files in `pipelines/demo` are what their README says.

use std::path::{Path, PathBuf};

use glam::{Vec2, Vec3};
use splatprobe::job::{MeshInput, SplatInput};

// Its `main` is the example's.
#[expect(dead_code)]
#[path = "../../examples/make_demo/main.rs"]
mod make_demo;

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("pipelines/demo")
}

/// Header and rows of 14 floats.
fn ply(path: &Path) -> (String, Vec<f32>) {
    let bytes = std::fs::read(path).unwrap();
    let end = bytes.windows(11).position(|window| window == b"end_header\n").unwrap() + 11;
    let floats = bytes[end..].chunks_exact(4).map(|f| f32::from_le_bytes(f.try_into().unwrap())).collect();
    (String::from_utf8(bytes[..end].to_vec()).unwrap(), floats)
}

fn lamp(folder: &Path) -> gltf::Gltf {
    gltf::Gltf::from_slice(&std::fs::read(folder.join("lamp.glb")).unwrap()).unwrap()
}

#[test]
fn the_example_writes_the_committed_files() {
    let made = tempfile::tempdir().unwrap();
    make_demo::write(made.path()).unwrap();
    let (header, rows) = ply(&folder().join("demo.ply"));
    let (made_header, made_rows) = ply(&made.path().join("demo.ply"));
    assert_eq!(header, made_header);
    assert_eq!(rows.len(), made_rows.len());
    // Platforms' logarithms and sines may differ in the last bits.
    assert!(rows.iter().zip(&made_rows).all(|(a, b)| (a - b).abs() < 1e-4));
    let [lamp, made_lamp] = [folder(), made.path().to_path_buf()].map(|folder| lamp(&folder));
    assert_eq!(lamp.blob.as_ref().map(Vec::len), made_lamp.blob.as_ref().map(Vec::len));
    assert_eq!(lamp.as_json().materials.len(), made_lamp.as_json().materials.len());
}

#[test]
fn demo_ply_stands_on_its_head_as_trainers_write_it() {
    let (header, rows) = ply(&folder().join("demo.ply"));
    assert!(header.contains("element vertex 52000\n") && rows.len() == 52_000 * 14);
    let inside = rows.chunks_exact(14).filter(|row| {
        let quaternion: f32 = row[10..].iter().map(|q| q * q).sum();
        assert!(row.iter().all(|value| value.is_finite()) && (quaternion - 1.0).abs() < 1e-5);
        (0.0..=10.0).contains(&row[0]) && (-2.8..=0.1).contains(&row[1]) && (-4.2..=0.0).contains(&row[2])
    });
    assert!(inside.count() > 51_950);
}

#[test]
fn flat_gaussians_of_the_floor_face_up_in_the_file() {
    let (_, rows) = ply(&folder().join("demo.ply"));
    // File +Y is down, so the floor is at y = 0 and the thinnest axis of what lies there is file Y.
    let mut faces_up = rows.chunks_exact(14).filter(|row| row[1].abs() < 0.002 && row[2] < -0.1).map(|row| {
        let thinnest = (0..3).min_by(|&a, &b| row[7 + a].total_cmp(&row[7 + b])).unwrap();
        let rotation = glam::Quat::from_xyzw(row[11], row[12], row[13], row[10]);
        (rotation * Vec3::AXES[thinnest]).y.abs() > 0.9
    });
    let (up, all) = faces_up.by_ref().fold((0, 0), |(up, all), is| (up + usize::from(is), all + 1));
    assert!(all > 500 && up * 10 > all * 9, "{up} of {all}");
}

#[test]
fn lamp_triangles_face_as_their_normals_and_the_picture_is_upright() {
    let lamp = lamp(&folder());
    let binary = lamp.blob.clone().unwrap();
    let mut modes = Vec::new();
    for mesh in lamp.meshes() {
        let primitive = mesh.primitives().next().unwrap();
        modes.push(primitive.material().alpha_mode());
        let bytes = |accessor: gltf::Accessor| {
            let view = accessor.view().unwrap();
            binary[view.offset()..view.offset() + view.length()].to_vec()
        };
        let attribute =
            |semantic| -> Vec<f32> { bytemuck::pod_collect_to_vec(&bytes(primitive.get(&semantic).unwrap())) };
        let positions: Vec<Vec3> = attribute(gltf::Semantic::Positions).chunks(3).map(Vec3::from_slice).collect();
        let normals: Vec<Vec3> = attribute(gltf::Semantic::Normals).chunks(3).map(Vec3::from_slice).collect();
        let uvs: Vec<Vec2> = attribute(gltf::Semantic::TexCoords(0)).chunks(2).map(Vec2::from_slice).collect();
        let indices: Vec<u16> = bytemuck::pod_collect_to_vec(&bytes(primitive.indices().unwrap()));
        for triangle in indices.chunks(3) {
            let [a, b, c] = [0, 1, 2].map(|k| positions[usize::from(triangle[k])]);
            let facing =
                (b - a).cross(c - a).dot(normals[usize::from(triangle[0])] + normals[usize::from(triangle[1])]);
            // The sphere's grid closes in triangles without area at its poles.
            assert!(facing > -1e-9, "{:?} {triangle:?}", mesh.name());
        }
        if mesh.name() == Some("picture") {
            for (position, uv) in positions.iter().zip(&uvs) {
                assert_eq!(position.y, if uv.y == 0.0 { 0.75 } else { 0.25 });
                assert!((position.x - (uv.x * 0.5 - 0.4)).abs() < 1e-6);
            }
        }
    }
    assert!(modes.contains(&gltf::material::AlphaMode::Mask) && modes.contains(&gltf::material::AlphaMode::Blend));
}

#[test]
fn the_jobs_inputs_exist() {
    let job: serde_json::Value = serde_json::from_slice(&std::fs::read(folder().join("demo.json")).unwrap()).unwrap();
    let splats: Vec<SplatInput> = serde_json::from_value(job["splats"].clone()).unwrap();
    let meshes: Vec<MeshInput> = serde_json::from_value(job["meshes"].clone()).unwrap();
    let paths = splats.iter().map(|input| &input.path).chain(meshes.iter().map(|input| &input.path));
    assert_eq!(paths.filter(|path| folder().join(path).is_file()).count(), 2);
}
