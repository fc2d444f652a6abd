// A mirror ball in Babylon.js, in its left-handed world.
import { Camera, Color3, Engine, FreeCamera, MeshBuilder, PBRMaterial, Scene, Vector3 } from '@babylonjs/core';
import { ReflectionProbes } from '/export/splatprobe-babylon.js';

export async function render(canvas, { position: [x, y, z], radius, distance }) {
  const engine = new Engine(canvas, false, { preserveDrawingBuffer: true, useExactSrgbConversions: true });
  const scene = new Scene(engine);
  const ball = MeshBuilder.CreateSphere('ball', { diameter: 2 * radius, segments: 96 }, scene);
  ball.position.set(-x, y, z);
  ball.material = new PBRMaterial('mirror', scene);
  Object.assign(ball.material, { metallic: 1, roughness: 0, albedoColor: Color3.White() });
  const probes = await ReflectionProbes.load('/export/probes.json', scene);
  probes.apply([ball]);
  const camera = new FreeCamera('camera', new Vector3(-x, y, z + distance), scene);
  camera.setTarget(ball.position);
  camera.mode = Camera.ORTHOGRAPHIC_CAMERA;
  [camera.minZ, camera.maxZ] = [distance / 2, 2 * distance];
  [camera.orthoLeft, camera.orthoRight, camera.orthoBottom, camera.orthoTop] = [-radius, radius, -radius, radius];
  await scene.whenReadyAsync();
  scene.render();
}
