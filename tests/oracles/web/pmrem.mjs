// Prefiltering beside three.js's PMREMGenerator: what both make of a probe's first mip, against brute force over all of its
// texels. The lobe is the same: GGX with view, normal and reflection in one direction, weighted by the cosine.
//
//   node pmrem.mjs TOOLS SPECULAR.ktx2
import fs from 'node:fs';
import http from 'node:http';
import path from 'node:path';
import assert from 'node:assert';
import { createRequire } from 'node:module';
import { pathToFileURL } from 'node:url';
import { half, locate, through } from './reference.mjs';

const [tools, file] = process.argv.slice(2).map((argument) => path.resolve(argument));
const require = createRequire(path.join(tools, 'package.json'));
const { chromium } = require('playwright-core');
const { read } = await import(pathToFileURL(require.resolve('ktx-parse')));
const { ZSTDDecoder } = await import(pathToFileURL(require.resolve('zstddec')));
const zstandard = new ZSTDDecoder();
await zstandard.init();

const container = read(new Uint8Array(fs.readFileSync(file)));
const size = container.pixelWidth;
const levels = container.levels.map((level) => {
  const bytes = zstandard.decode(level.levelData, level.uncompressedByteLength);
  return new Uint16Array(bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.length));
});

// Every texel of the first mip: its direction, the solid angle it fills, its light.
const texels = [];
for (let slot = 0; slot < 6; slot++) {
  for (let i = 0; i < size * size; i++) {
    const [s, t] = [i % size, Math.floor(i / size)].map((place) => (2 * (place + 0.5)) / size - 1);
    const length = Math.sqrt(1 + s * s + t * t);
    const at = 4 * (slot * size * size + i);
    texels.push([through[slot](s, t).map((x) => x / length), length ** -3, [0, 1, 2].map((k) => half(levels[0][at + k]))]);
  }
}

/** The texels' mean under the lobe of a roughness around a direction. */
function bruteForce(direction, roughness) {
  const squared = roughness ** 4;
  const sum = [0, 0, 0];
  let weights = 0;
  for (const [d, solidAngle, light] of texels) {
    const cosine = d[0] * direction[0] + d[1] * direction[1] + d[2] * direction[2];
    if (cosine <= 0) continue;
    const weight = (solidAngle * cosine) / (((1 + cosine) / 2) * (squared - 1) + 1) ** 2;
    light.forEach((value, k) => (sum[k] += weight * value));
    weights += weight;
  }
  return sum.map((value) => value / weights);
}

// What three.js makes of it: mips of a cube map that are looked up by a direction.
const render = async (canvas, { size, faces, directions }) => {
  const THREE = await import('/three.js');
  const renderer = new THREE.WebGLRenderer({ canvas });
  const images = faces.map((face) => new THREE.DataTexture(new Uint16Array(face), size, size, THREE.RGBAFormat, THREE.HalfFloatType));
  const cube = new THREE.CubeTexture(images);
  Object.assign(cube, { type: THREE.HalfFloatType, format: THREE.RGBAFormat, generateMipmaps: false, needsUpdate: true });
  const { texture } = new THREE.PMREMGenerator(renderer).fromCubemap(cube);
  const [width, last] = [directions.length, texture.mipmaps.length - 1];
  const places = new THREE.DataTexture(Float32Array.from(directions.flatMap((d) => [...d, 0])), width, 1, THREE.RGBAFormat, THREE.FloatType);
  places.needsUpdate = true;
  const target = new THREE.WebGLRenderTarget(width, 1, { type: THREE.FloatType });
  const material = new THREE.ShaderMaterial({
    uniforms: { cube: { value: texture }, places: { value: places }, lod: { value: 0 } },
    vertexShader: 'void main() { gl_Position = vec4(position.xy, 0.0, 1.0); }',
    fragmentShader: `uniform samplerCube cube; uniform sampler2D places; uniform float lod;
      void main() { gl_FragColor = textureLod(cube, texelFetch(places, ivec2(gl_FragCoord.xy), 0).xyz, lod); }`,
  });
  const scene = new THREE.Scene().add(new THREE.Mesh(new THREE.PlaneGeometry(2, 2), material));
  return Array.from({ length: last + 1 }, (_, lod) => {
    material.uniforms.lod.value = lod;
    renderer.setRenderTarget(target);
    renderer.render(scene, new THREE.Camera());
    const pixels = new Float32Array(4 * width);
    renderer.readRenderTargetPixels(target, 0, 0, width, 1, pixels);
    return { roughness: THREE.PMREMGenerator.lodToRoughness(lod, last), pixels: Array.from(pixels) };
  });
};

const server = http.createServer((request, response) => {
  const name = { '/three.js': 'three.module.js', '/three.core.js': 'three.core.js' }[request.url];
  response.setHeader('content-type', name ? 'text/javascript' : 'text/html');
  response.end(name ? fs.readFileSync(path.join(tools, 'node_modules/three/build', name)) : '<canvas></canvas>');
});
await new Promise((resolve) => server.listen(0, '127.0.0.1', resolve));
const args = ['--no-sandbox', '--use-gl=angle', '--use-angle=swiftshader', '--enable-unsafe-swiftshader', '--ignore-gpu-blocklist'];
const browser = await chromium.launch({ executablePath: process.env.CHROMIUM ?? '/usr/bin/chromium', args });
const tab = await browser.newPage();
tab.on('pageerror', (error) => assert.fail(error));
await tab.goto(`http://127.0.0.1:${server.address().port}/`);

// Directions spread over the sphere; for our mips the texels they fall into.
const COUNT = 24;
const golden = Math.PI * (3 - Math.sqrt(5));
const spiral = Array.from({ length: COUNT }, (_, i) => {
  const y = 1 - (2 * i + 1) / COUNT;
  return [Math.cos(golden * i) * Math.sqrt(1 - y * y), y, Math.sin(golden * i) * Math.sqrt(1 - y * y)];
});
const faces = Array.from({ length: 6 }, (_, slot) => Array.from(levels[0].subarray(4 * slot * size * size, 4 * (slot + 1) * size * size)));

/** Relative root mean square of `found(i)` to the lobe's truth around `directions`. */
function error(directions, roughness, found) {
  let [difference, power] = [0, 0];
  directions.forEach((direction, i) => bruteForce(direction, roughness).forEach((truth, k) => {
    difference += (found(i)[k] - truth) ** 2;
    power += truth;
  }));
  const count = 3 * directions.length;
  return Math.sqrt(difference / count) / (power / count);
}

console.log('| by | roughness | relative RMSE to brute force |\n|---|---|---|');
const row = (by, roughness, error) => console.log(`| ${by} | ${roughness.toFixed(3)} | ${(100 * error).toFixed(3)} % |`);
const last = levels.length - 1;
assert.ok(last > 0, 'there are no mips to compare');
let worst = 0;
const theirs = await tab.locator('canvas').evaluate(render, { size, faces, directions: spiral });
// three.js looks cube maps of data up mirrored.
const mirrored = spiral.map(([x, y, z]) => [-x, y, z]);
for (const { roughness, pixels } of theirs.slice(1)) {
  const found = error(mirrored, roughness, (i) => pixels.slice(4 * i, 4 * i + 3));
  assert.ok(found < 0.05, `three.js is ${found} off: it was given or asked something else`);
  row('three.js, between texels', roughness, found);
}
for (let mip = 1; mip <= last; mip++) {
  const edge = size >> mip;
  const texelOf = (direction) => {
    const [slot, s, t] = locate(direction);
    const [x, y] = [s, t].map((place) => Math.min(edge - 1, Math.floor(place * edge)));
    return [slot, x, y];
  };
  const own = spiral.map(texelOf);
  const directions = own.map(([slot, x, y]) => {
    const d = through[slot]((2 * (x + 0.5)) / edge - 1, (2 * (y + 0.5)) / edge - 1);
    return d.map((value) => value / Math.hypot(...d));
  });
  const found = (i) => [0, 1, 2].map((k) => half(levels[mip][4 * ((own[i][0] * edge + own[i][2]) * edge + own[i][1]) + k]));
  const ours = error(directions, mip / last, found);
  worst = Math.max(worst, ours);
  row('splatprobe, at texels', mip / last, ours);
}
await browser.close();
server.close();
assert.ok(worst < 0.01, `${worst} is more than a hundredth`);
