//! Mirror balls in Bevy, lit by an export alone, compared with what the bake holds. No window.
//!
//!     bevy-oracle BAKE EXPORT PICTURES
//!
//! A white metal of roughness 0 reflects all light in Bevy: its polynomial for the environment's BRDF sums to 1 there, and
//! what it lacks elsewhere would come back as scattered light. Bevy clamps roughness to 0.089^2 for everything but the choice
//! of the mip, which is mip 0; what is left of that is that rays are bent by 0.4 % of the way to the normal, 0.23 degrees at
//! most, where a texel of a face of 128 px covers 0.45 to 0.9. The reference does not bend them.

mod bake;
mod splatprobe;

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use bevy::app::PluginsState;
use bevy::asset::{AssetPlugin, LoadState};
use bevy::camera::{Hdr, RenderTarget, ScalingMode};
use bevy::core_pipeline::tonemapping::{DebandDither, Tonemapping};
use bevy::light::GlobalAmbientLight;
use bevy::math::DVec3;
use bevy::prelude::*;
use bevy::render::gpu_readback::{Readback, ReadbackComplete};
use bevy::render::pipelined_rendering::PipelinedRenderingPlugin;
use bevy::render::render_resource::{TextureFormat, TextureUsages, WgpuFeatures};
use bevy::render::renderer::{RenderAdapterInfo, RenderDevice};
use bevy::window::{ExitCondition, WindowPlugin};
use half::f16;

/// Largest root of the mean squared difference, in 255ths of what a display shows.
const LIMIT: f64 = 2.0;

/// Edge of a picture.
const SIZE: usize = 256;

/// Radius of a ball and how far off its camera is, in metres.
const RADIUS: f32 = 0.05;
const DISTANCE: f32 = 1.0;

/// Share of a ball's radius that is compared: nearer to its rim, triangles are too coarse for grazing rays.
const COMPARED: f64 = 0.95;

/// Loading, shaders and pictures together may take this long.
const PATIENCE: Duration = Duration::from_secs(120);

/// Frames in which nothing may change before a picture counts.
const QUIET: u32 = 10;

/// What a camera shows: RGBA of half floats.
#[derive(Component, Default)]
struct Picture {
    name: String,
    middle: Vec3,
    bytes: Vec<u8>,
    unchanged: u32,
}

fn main() {
    let mut arguments = std::env::args_os().skip(1).map(PathBuf::from);
    let (Some(bake), Some(export), Some(pictures)) = (arguments.next(), arguments.next(), arguments.next()) else {
        fail("usage: bevy-oracle BAKE EXPORT PICTURES");
    };
    let probes = bake::probes(&bake);
    let mut app = app(&export);
    // At every probe, and away from it where parallax counts.
    for probe in &probes {
        let aside = probe.position + (probe.proxy[1] - probe.position) * DVec3::new(0.2, 0.3, 0.4);
        for (place, middle) in [("at", probe.position), ("aside", aside)] {
            add_ball(app.world_mut(), format!("{}-{place}", probe.id), middle.as_vec3());
        }
    }
    let mut worst: f64 = 0.0;
    for picture in render(&mut app) {
        let found = shown(&picture.bytes);
        let expected = reflected(&probes, picture.middle.as_dvec3());
        save(&pictures.join(format!("bevy-{}.png", picture.name)), &found);
        save(&pictures.join(format!("bevy-{}-expected.png", picture.name)), &expected);
        let (rms, most) = difference(&found, &expected);
        println!("bevy-{}: {rms:.3} / 255, {most} at most", picture.name);
        worst = worst.max(rms);
    }
    if worst > LIMIT {
        fail(format!("{worst:.3} / 255 is more than {LIMIT}"));
    }
}

fn fail(message: impl AsRef<str>) -> ! {
    eprintln!("{}", message.as_ref());
    std::process::exit(1)
}

/// Bevy with the exported plugin and its assets, no light but the probes', and nobody at the window.
fn app(export: &Path) -> App {
    let mut app = App::new();
    let assets = export.join("assets").canonicalize().unwrap().to_str().unwrap().to_owned();
    let plugins = DefaultPlugins
        .set(AssetPlugin { file_path: assets, ..default() })
        .set(WindowPlugin { primary_window: None, exit_condition: ExitCondition::DontExit, ..default() })
        // Frames are counted here, so that an update is a frame.
        .disable::<PipelinedRenderingPlugin>();
    app.add_plugins((plugins, splatprobe::SplatprobePlugin))
        .insert_resource(GlobalAmbientLight { brightness: 0.0, ..default() })
        .add_observer(keep);
    while app.plugins_state() == PluginsState::Adding {
        bevy::tasks::tick_global_task_pools_on_main_thread();
    }
    app.finish();
    app.cleanup();
    let driver = &app.world().resource::<RenderAdapterInfo>().0;
    println!("Bevy on {}, {} {}", driver.name, driver.driver, driver.driver_info);
    let arrays = WgpuFeatures::TEXTURE_BINDING_ARRAY
        | WgpuFeatures::SAMPLED_TEXTURE_AND_STORAGE_BUFFER_ARRAY_NON_UNIFORM_INDEXING;
    if !app.world().resource::<RenderDevice>().features().contains(arrays) {
        fail("this Vulkan driver has no binding arrays, without which Bevy ignores light probes");
    }
    app
}

/// A mirror ball, and a camera that looks at it from +Z without perspective.
fn add_ball(world: &mut World, name: String, middle: Vec3) {
    let mesh = world.resource_mut::<Assets<Mesh>>().add(Sphere::new(RADIUS).mesh().uv(256, 128));
    let mirror = StandardMaterial { base_color: Color::WHITE, metallic: 1.0, perceptual_roughness: 0.0, ..default() };
    let mirror = world.resource_mut::<Assets<StandardMaterial>>().add(mirror);
    world.spawn((Mesh3d(mesh), MeshMaterial3d(mirror), Transform::from_translation(middle)));
    let mut image = Image::new_target_texture(SIZE as u32, SIZE as u32, TextureFormat::Rgba16Float, None);
    image.texture_descriptor.usage |= TextureUsages::COPY_SRC;
    let image = world.resource_mut::<Assets<Image>>().add(image);
    let projection = OrthographicProjection {
        // No other ball comes into view.
        near: DISTANCE - 2.0 * RADIUS,
        far: DISTANCE + 2.0 * RADIUS,
        scaling_mode: ScalingMode::Fixed { width: 2.0 * RADIUS, height: 2.0 * RADIUS },
        ..OrthographicProjection::default_3d()
    };
    world.spawn((
        Camera3d::default(),
        Camera { clear_color: ClearColorConfig::Custom(Color::NONE), ..default() },
        RenderTarget::Image(image.clone().into()),
        Projection::Orthographic(projection),
        Transform::from_translation(middle + DISTANCE * Vec3::Z),
        (Hdr, Msaa::Off, Tonemapping::None, DebandDither::Disabled),
        Readback::texture(image),
        Picture { name, middle, ..default() },
    ));
}

fn keep(done: On<ReadbackComplete>, mut pictures: Query<&mut Picture>) {
    let mut picture = pictures.get_mut(done.entity).unwrap();
    if picture.bytes == done.data {
        picture.unchanged += 1;
    } else {
        picture.bytes.clone_from(&done.data);
        picture.unchanged = 0;
    }
}

/// Renders until all is loaded and every ball is drawn and stays the same.
fn render(app: &mut App) -> Vec<Picture> {
    let start = Instant::now();
    let mut frames_since_load = 0;
    loop {
        app.update();
        let world = app.world_mut();
        let missing = missing(world);
        frames_since_load = if missing.is_empty() { frames_since_load + 1 } else { 0 };
        let mut pictures = world.query::<&mut Picture>();
        let is_drawn = |picture: &Picture| {
            picture.bytes.get(pixel(SIZE / 2, SIZE / 2) + 6..).is_some_and(|alpha| alpha[..2] != [0; 2])
        };
        let is_done = |picture: &Picture| is_drawn(picture) && picture.unchanged >= QUIET;
        if frames_since_load > QUIET && pictures.iter(world).all(is_done) {
            return pictures.iter_mut(world).map(|mut picture| std::mem::take(&mut *picture)).collect();
        }
        if start.elapsed() > PATIENCE {
            let undone = pictures.iter(world).filter(|picture| !is_done(picture)).map(|picture| picture.name.clone());
            let undone: Vec<_> = missing.into_iter().chain(undone).collect();
            fail(format!("not loaded or not drawn after {} s: {}", PATIENCE.as_secs(), undone.join(", ")));
        }
    }
}

/// Cube maps that are not loaded yet.
fn missing(world: &mut World) -> Vec<String> {
    let mut lights = world.query::<&EnvironmentMapLight>();
    let server = world.resource::<AssetServer>();
    let maps = lights.iter(world).flat_map(|light| [&light.diffuse_map, &light.specular_map]);
    let missing = maps.filter(|map| match server.load_state(*map) {
        LoadState::Failed(error) => fail(error.to_string()),
        state => !state.is_loaded(),
    });
    missing.map(|map| map.path().map_or_else(|| "a cube map".to_owned(), ToString::to_string)).collect()
}

/// Where a pixel of half floats begins.
fn pixel(x: usize, y: usize) -> usize {
    8 * (y * SIZE + x)
}

/// RGBA bytes of what was rendered, as a display shows it.
fn shown(bytes: &[u8]) -> Vec<u8> {
    let half = |two: &[u8]| f64::from(f16::from_le_bytes([two[0], two[1]]));
    bytes.chunks(8).flat_map(|p| encode(DVec3::new(half(p), half(&p[2..]), half(&p[4..])), half(&p[6..]))).collect()
}

/// RGBA bytes of what a mirror ball there reflects; alpha is 0 where it is not compared.
fn reflected(probes: &[bake::Probe], middle: DVec3) -> Vec<u8> {
    let mut bytes = Vec::new();
    for (row, column) in (0..SIZE).flat_map(|row| (0..SIZE).map(move |column| (row, column))) {
        let place = |index: usize| (2 * index + 1) as f64 / SIZE as f64 - 1.0;
        let (x, y) = (place(column), -place(row));
        if x.hypot(y) > COMPARED {
            bytes.extend([0; 4]);
            continue;
        }
        let normal = DVec3::new(x, y, (1.0 - x * x - y * y).sqrt());
        let direction = 2.0 * normal.z * normal - DVec3::Z;
        let light = bake::radiance(probes, middle + f64::from(RADIUS) * normal, direction);
        bytes.extend(encode(light, 1.0));
    }
    bytes
}

/// sRGB.
fn encode(linear: DVec3, alpha: f64) -> [u8; 4] {
    let curve = |v: f64| if v <= 0.003_130_8 { 12.92 * v } else { 1.055 * v.powf(1.0 / 2.4) - 0.055 };
    let [r, g, b] = linear.to_array().map(|v| curve(v.clamp(0.0, 1.0)));
    [r, g, b, alpha].map(|v| (255.0 * v).round() as u8)
}

/// Root of the mean squared difference and the largest, over all channels where the reference is opaque, in 255ths.
fn difference(found: &[u8], expected: &[u8]) -> (f64, u8) {
    let compared = found.chunks(4).zip(expected.chunks(4)).filter(|(_, expected)| expected[3] != 0);
    let channels: Vec<u8> = compared.flat_map(|(a, b)| [0, 1, 2].map(|k| a[k].abs_diff(b[k]))).collect();
    let squares: f64 = channels.iter().map(|d| f64::from(*d).powi(2)).sum();
    ((squares / channels.len() as f64).sqrt(), channels.into_iter().max().unwrap())
}

fn save(path: &Path, rgba: &[u8]) {
    image::save_buffer(path, rgba, SIZE as u32, SIZE as u32, image::ColorType::Rgba8).unwrap();
}
