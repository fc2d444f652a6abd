// Reflection probes baked by splatprobe, in PlayCanvas: StandardMaterial, WebGL 2.
//
//   import { ReflectionProbes } from './splatprobe-playcanvas.js';
//   const probes = await ReflectionProbes.load('probes.json', app.graphicsDevice);
//   probes.apply(meshInstances);    // once for what stands still
//   probes.update(meshInstances);   // again for what has moved
//
// World space is the frame of the bake: right-handed, +Y up, metres.

import {
  ADDRESS_CLAMP_TO_EDGE, FILTER_LINEAR, FILTER_LINEAR_MIPMAP_LINEAR, PIXELFORMAT_RGBA16F, SHADERLANGUAGE_GLSL,
  StandardMaterial, Texture,
} from 'playcanvas';
import { MAX_PROBES, load, selection } from './load.js';

const GLSL = `{{glsl}}`;

// Stands in both chunks; the first counts.
const PROBES = `
#ifndef SPLATPROBE
#define SPLATPROBE
${GLSL}
#endif
`;

// In place of the engine's look-ups into a cube map and into ambient light.
const REFLECTION = `
${PROBES}
uniform float material_reflectivity;

vec3 calcReflection(vec3 reflDir, float gloss) {
  return probesRadiance(vPositionW, normalize(reflDir), 1.0 - gloss);
}

void addReflection(vec3 reflDir, float gloss) {
  dReflection += vec4(calcReflection(reflDir, gloss), material_reflectivity);
}
`;

const AMBIENT = `
${PROBES}
void addAmbient(vec3 worldNormal) {
  dDiffuseLight += probeIrradiance(probeSh, worldNormal);
}
`;

export class ReflectionProbes {
  /** Loads probes.json and the cube maps beside it. */
  static async load(url, device) {
    const { manifest, cubes } = await load(url);
    return new ReflectionProbes(manifest, cubes.map((cube) => texture(device, cube)));
  }

  constructor(manifest, textures) {
    this.manifest = manifest;
    this.textures = textures;
  }

  /** Lights `meshInstances` by the probes around each. Their materials are replaced by copies. */
  apply(meshInstances) {
    for (const instance of meshInstances) {
      if (!(instance.material instanceof StandardMaterial)) continue;
      const material = instance.material.clone();
      // Without a cube map the shader has no place for one.
      material.cubeMap = this.textures[0];
      material.shaderChunksVersion = '2.23';
      const chunks = material.getShaderChunks(SHADERLANGUAGE_GLSL);
      chunks.set('reflectionCubePS', REFLECTION);
      chunks.set('ambientPS', AMBIENT);
      material.update();
      instance.material = material;
    }
    this.update(meshInstances);
  }

  /** Chooses the probes of `meshInstances` again. */
  update(meshInstances) {
    for (const instance of meshInstances) {
      const { x, y, z } = instance.aabb.center;
      const { probes, weights, sh } = selection(this.manifest, [x, y, z]);
      const records = probes.map((probe) => this.manifest.probes[probe]);
      const vectors = (of) => new Float32Array(records.flatMap(of));
      probes.forEach((probe, i) => instance.setParameter(`probeCube${i}`, this.textures[probe]));
      instance.setParameter('probeWeights[0]', new Float32Array(weights));
      instance.setParameter('probeTakenAt[0]', vectors((record) => record.position));
      instance.setParameter('probeProxyMin[0]', vectors((record) => record.proxy.min));
      instance.setParameter('probeProxyMax[0]', vectors((record) => record.proxy.max));
      instance.setParameter('probeSh[0]', new Float32Array(sh));
      instance.setParameter('probeRoughestMip', this.textures[probes[0]].roughestMip);
    }
  }
}

/** The cube map with all its mips. The engine wants them down to a texel; below the roughest nothing is looked up. */
function texture(device, { size, mips }) {
  const levels = [...mips];
  for (let edge = size >> mips.length; edge > 0; edge >>= 1) {
    levels.push(Array.from({ length: 6 }, () => new Uint16Array(4 * edge * edge)));
  }
  const cube = new Texture(device, {
    cubemap: true,
    width: size,
    height: size,
    format: PIXELFORMAT_RGBA16F,
    levels,
    minFilter: FILTER_LINEAR_MIPMAP_LINEAR,
    magFilter: FILTER_LINEAR,
    addressU: ADDRESS_CLAMP_TO_EDGE,
    addressV: ADDRESS_CLAMP_TO_EDGE,
  });
  cube.roughestMip = mips.length - 1;
  return cube;
}
