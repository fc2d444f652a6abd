// Reflection probes baked by splatprobe, in three.js: MeshStandardMaterial and what derives from it, WebGLRenderer.
//
//   import { ReflectionProbes } from './splatprobe-three.js';
//   const probes = await ReflectionProbes.load('probes.json');
//   probes.apply(scene);          // once for what stands still
//   probes.update(object);        // again for what has moved
//
// World space is the frame of the bake: right-handed, +Y up, metres.

import * as THREE from 'three';
import { MAX_PROBES, load, selection } from './load.js';

const GLSL = `{{glsl}}`;

// After the engine's own look-ups into an environment. roughnessFactor is the material's roughness without the engine's
// lower bound; rows of the view matrix's rotation take a direction back to the world.
const LIGHT = `
{
  vec3 position = cameraPosition - (vec4(vViewPosition, 0.0) * viewMatrix).xyz;
  vec3 mirrored = reflect(-geometryViewDir, geometryNormal);
  vec3 bent = normalize(mix(mirrored, geometryNormal, pow(roughnessFactor, 4.0)));
  radiance += probesRadiance(position, (vec4(bent, 0.0) * viewMatrix).xyz, roughnessFactor);
  iblIrradiance += PI * probeIrradiance(probeSh, (vec4(geometryNormal, 0.0) * viewMatrix).xyz);
  #ifdef USE_CLEARCOAT
    mirrored = reflect(-geometryViewDir, geometryClearcoatNormal);
    clearcoatRadiance += probesRadiance(position, (vec4(mirrored, 0.0) * viewMatrix).xyz, material.clearcoatRoughness);
  #endif
}
`;

export class ReflectionProbes {
  /** Loads probes.json and the cube maps beside it. */
  static async load(url) {
    const { manifest, cubes } = await load(url);
    return new ReflectionProbes(manifest, cubes.map(texture));
  }

  constructor(manifest, textures) {
    this.manifest = manifest;
    this.textures = textures;
    this.uniforms = new WeakMap();
  }

  /** Lights all meshes under `object` by the probes around each. Their materials are replaced by copies. */
  apply(object) {
    object.traverse((mesh) => {
      if (!mesh.isMesh) return;
      const uniforms = emptyUniforms();
      const patched = (material) => (material.isMeshStandardMaterial ? patch(material.clone(), uniforms) : material);
      mesh.material = Array.isArray(mesh.material) ? mesh.material.map(patched) : patched(mesh.material);
      this.uniforms.set(mesh, uniforms);
    });
    this.update(object);
  }

  /** Chooses the probes of all meshes under `object` again. */
  update(object) {
    object.updateWorldMatrix(true, true);
    object.traverse((mesh) => {
      const uniforms = this.uniforms.get(mesh);
      if (!uniforms) return;
      if (!mesh.geometry.boundingSphere) mesh.geometry.computeBoundingSphere();
      const centre = mesh.geometry.boundingSphere.center.clone().applyMatrix4(mesh.matrixWorld);
      const { probes, weights, sh } = selection(this.manifest, centre.toArray());
      probes.forEach((probe, i) => {
        const { position, proxy } = this.manifest.probes[probe];
        uniforms[`probeCube${i}`].value = this.textures[probe];
        uniforms.probeTakenAt.value[i].fromArray(position);
        uniforms.probeProxyMin.value[i].fromArray(proxy.min);
        uniforms.probeProxyMax.value[i].fromArray(proxy.max);
      });
      uniforms.probeWeights.value = weights;
      uniforms.probeSh.value.forEach((factor, i) => factor.fromArray(sh, 3 * i));
      uniforms.probeRoughestMip.value = this.textures[probes[0]].mipmaps.length;
    });
  }
}

/** The cube map with all its mips. */
function texture({ size, mips }) {
  const face = (data, edge) => new THREE.DataTexture(data, edge, edge, THREE.RGBAFormat, THREE.HalfFloatType);
  const level = (mip) => mips[mip].map((data) => face(data, size >> mip));
  const cube = new THREE.CubeTexture(level(0));
  cube.mipmaps = mips.slice(1).map((_, i) => new THREE.CubeTexture(level(i + 1)));
  cube.type = THREE.HalfFloatType;
  cube.format = THREE.RGBAFormat;
  cube.colorSpace = THREE.LinearSRGBColorSpace;
  cube.minFilter = THREE.LinearMipmapLinearFilter;
  cube.magFilter = THREE.LinearFilter;
  cube.generateMipmaps = false;
  cube.flipY = false;
  cube.needsUpdate = true;
  return cube;
}

function emptyUniforms() {
  const vectors = (count) => Array.from({ length: count }, () => new THREE.Vector3());
  const uniforms = { probeWeights: { value: [] }, probeSh: { value: vectors(9) }, probeRoughestMip: { value: 0 } };
  for (const name of ['probeTakenAt', 'probeProxyMin', 'probeProxyMax']) uniforms[name] = { value: vectors(MAX_PROBES) };
  for (let i = 0; i < MAX_PROBES; i++) uniforms[`probeCube${i}`] = { value: null };
  return uniforms;
}

function patch(material, uniforms) {
  material.onBeforeCompile = (shader) => {
    Object.assign(shader.uniforms, uniforms);
    shader.fragmentShader = shader.fragmentShader
      .replace('#include <lights_physical_pars_fragment>', `#include <lights_physical_pars_fragment>\n${GLSL}`)
      .replace('#include <lights_fragment_maps>', `#include <lights_fragment_maps>\n${LIGHT}`);
  };
  material.customProgramCacheKey = () => 'splatprobe';
  return material;
}
