// A mirror ball in three.js.
import * as THREE from 'three';
import { ReflectionProbes } from '/export/splatprobe-three.js';

export async function render(canvas, { position: [x, y, z], radius, distance }) {
  const renderer = new THREE.WebGLRenderer({ canvas, preserveDrawingBuffer: true });
  const scene = new THREE.Scene();
  const material = new THREE.MeshStandardMaterial({ metalness: 1, roughness: 0 });
  const ball = new THREE.Mesh(new THREE.SphereGeometry(radius, 256, 128), material);
  ball.position.set(x, y, z);
  scene.add(ball);
  const probes = await ReflectionProbes.load('/export/probes.json');
  probes.apply(scene);
  const camera = new THREE.OrthographicCamera(-radius, radius, radius, -radius, distance / 2, 2 * distance);
  camera.position.set(x, y, z + distance);
  renderer.render(scene, camera);
}
