fn cpu() -> f64 { std::fs::read_to_string("/proc/thread-self/schedstat").unwrap().split(' ').next().unwrap().parse::<f64>().unwrap()*1e-9 }
use glam::DVec3;
use splatprobe::bvh::Bvh;
use splatprobe::generate::{InteriorSettings, ROOM, interior};
use splatprobe::scene::Scene;
use splatprobe::shade::UnlitSurfaces;
use splatprobe::trace::{Face, Ray, RayTracer, Tile, TraceSettings};
fn main() {
    let n: usize = std::env::args().nth(1).and_then(|s| s.parse().ok()).unwrap_or(1_000_000);
    let splats = interior(&InteriorSettings { gaussians: n, sh_degree: 3, ..InteriorSettings::default() });
    let mut scene = Scene { splats, ..Scene::default() };
    let bvh = Bvh::build(&mut scene);
    let probe = DVec3::new(1.5 * ROOM.x, 1.6, 1.5 * ROOM.z) - scene.origin;
    let surfaces = UnlitSurfaces::new(&scene.meshes);
    let t = RayTracer { scene: &scene, bvh: &bvh, surfaces: &surfaces, settings: TraceSettings::default() };
    let faces: usize = std::env::args().nth(2).and_then(|s| s.parse().ok()).unwrap_or(6);
    for k in [1usize].into_iter().chain((faces == 6).then_some(8)) {
        let (mut time, mut rays) = (0.0, 0);
        for face in Face::ALL.into_iter().take(faces) {
            let tile = Tile { face, face_size: 256, x: 64, y: 128, width: 64, height: 64 };
            let mut scratch = Default::default();
            let directions: Vec<_> = tile.directions().collect();
            let s = cpu();
            let mut sum = 0.0;
            for &direction in &directions {
                for _ in 0..k {
                    let r = t.trace(&Ray { origin: probe, direction }, &mut scratch);
                    sum += r.transmittance as f64;
                }
            }
            time += cpu() - s;
            rays += directions.len();
            std::hint::black_box(sum);
        }
        println!("k {k}: {:.2} us per ray, {:.2} per trace", time / rays as f64 * 1e6, time / rays as f64 / k as f64 * 1e6);
    }
}
