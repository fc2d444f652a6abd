// Reflection probes baked by splatprobe, in Babylon.js: PBRMaterial and what derives from it, WebGL 2.
//
//   import { ReflectionProbes } from './splatprobe-babylon.js';
//   const probes = await ReflectionProbes.load('probes.json', scene);
//   probes.apply(scene.meshes);   // once for what stands still
//   probes.update(meshes);        // again for what has moved
//
// The world is where Babylon.js puts a glTF file of the bake's frame: of a left-handed scene that is (-x, y, z).

import { Constants, MaterialPluginBase, PBRBaseMaterial, RawCubeTexture, Texture } from '@babylonjs/core';
import { MAX_PROBES, load, selection } from './load.js';

const GLSL = `{{glsl}}`;

// In place of the engine's look-ups into an environment. probeFromWorld is the sign of x.
const LIGHT = `
{
  vec3 probeSigns = vec3(probeFromWorld, 1.0, 1.0);
  vec3 mirrored = reflect(-viewDirectionW, normalW);
  vec3 bent = normalize(mix(mirrored, normalW, pow(roughness, 4.0))) * probeSigns;
  reflectionOut.environmentRadiance = vec4(probesRadiance(vPositionW * probeSigns, bent, roughness), 1.0);
  reflectionOut.environmentIrradiance = probeIrradiance(probeSh, normalW * probeSigns);
  reflectionOut.reflectionCoords = mirrored;
}
`;

const CUBES = Array.from({ length: MAX_PROBES }, (_, i) => `probeCube${i}`);

export class ReflectionProbes {
  /** Loads probes.json and the cube maps beside it. */
  static async load(url, scene) {
    const { manifest, cubes } = await load(url);
    return new ReflectionProbes(manifest, cubes.map((cube) => texture(cube, scene)), scene);
  }

  constructor(manifest, textures, scene) {
    this.manifest = manifest;
    this.textures = textures;
    this.fromWorld = scene.useRightHandedSystem ? 1 : -1;
    this.plugins = new WeakMap();
  }

  /** Lights `meshes` by the probes around each. Their materials are replaced by copies. */
  apply(meshes) {
    for (const mesh of meshes) {
      if (!(mesh.material instanceof PBRBaseMaterial)) continue;
      const material = mesh.material.clone(mesh.material.name);
      // Without an environment the shader has no place for one.
      material.reflectionTexture = this.textures[0];
      this.plugins.set(mesh, new ProbePlugin(material));
      mesh.material = material;
    }
    this.update(meshes);
  }

  /** Chooses the probes of `meshes` again. */
  update(meshes) {
    for (const mesh of meshes) {
      const plugin = this.plugins.get(mesh);
      if (!plugin) continue;
      mesh.computeWorldMatrix(true);
      const { x, y, z } = mesh.getBoundingInfo().boundingSphere.centerWorld;
      const { probes, weights, sh } = selection(this.manifest, [x * this.fromWorld, y, z]);
      const records = probes.map((probe) => this.manifest.probes[probe]);
      plugin.choice = {
        cubes: probes.map((probe) => this.textures[probe]),
        weights,
        takenAt: records.flatMap((record) => record.position),
        proxyMin: records.flatMap((record) => record.proxy.min),
        proxyMax: records.flatMap((record) => record.proxy.max),
        sh,
        fromWorld: this.fromWorld,
        roughestMip: this.textures[probes[0]].roughestMip,
      };
    }
  }
}

/** The cube map with all its mips. */
function texture({ size, mips }, scene) {
  const { TEXTUREFORMAT_RGBA, TEXTURETYPE_HALF_FLOAT } = Constants;
  const cube = new RawCubeTexture(scene, null, size, TEXTUREFORMAT_RGBA, TEXTURETYPE_HALF_FLOAT, true, false, Texture.TRILINEAR_SAMPLINGMODE);
  const engine = scene.getEngine();
  const internal = cube.getInternalTexture();
  internal.generateMipMaps = false;
  // texImage2D reads width and height from the texture.
  mips.forEach((faces, mip) => {
    [internal.width, internal.height] = [size >> mip, size >> mip];
    engine.updateRawCubeTexture(internal, faces, TEXTUREFORMAT_RGBA, TEXTURETYPE_HALF_FLOAT, false, null, mip);
  });
  [internal.width, internal.height] = [size, size];
  const gl = engine._gl;
  engine._bindTextureDirectly(gl.TEXTURE_CUBE_MAP, internal, true);
  gl.texParameteri(gl.TEXTURE_CUBE_MAP, gl.TEXTURE_MAX_LEVEL, mips.length - 1);
  engine._bindTextureDirectly(gl.TEXTURE_CUBE_MAP, null);
  cube.roughestMip = mips.length - 1;
  return cube;
}

class ProbePlugin extends MaterialPluginBase {
  constructor(material) {
    super(material, 'SplatprobeProbes', 200, { USE_CUSTOM_REFLECTION: false });
    this.choice = null;
    // Without this, hardBindForSubMesh is not called.
    this.registerForExtraEvents = true;
    this._enable(true);
  }

  getClassName() {
    return 'SplatprobeProbes';
  }

  prepareDefines(defines) {
    defines.USE_CUSTOM_REFLECTION = true;
  }

  getSamplers(samplers) {
    samplers.push(...CUBES);
  }

  getUniforms() {
    return { externalUniforms: ['probeWeights', 'probeTakenAt', 'probeProxyMin', 'probeProxyMax', 'probeSh', 'probeRoughestMip', 'probeFromWorld'] };
  }

  hardBindForSubMesh(_, scene, engine, subMesh) {
    const { effect } = subMesh;
    const { cubes, weights, takenAt, proxyMin, proxyMax, sh, fromWorld, roughestMip } = this.choice;
    CUBES.forEach((name, i) => effect.setTexture(name, cubes[i]));
    effect.setFloatArray('probeWeights', weights);
    effect.setArray3('probeTakenAt', takenAt);
    effect.setArray3('probeProxyMin', proxyMin);
    effect.setArray3('probeProxyMax', proxyMax);
    effect.setArray3('probeSh', sh);
    effect.setFloat('probeRoughestMip', roughestMip);
    effect.setFloat('probeFromWorld', fromWorld);
  }

  getCustomCode(shaderType) {
    if (shaderType !== 'fragment') return null;
    return { CUSTOM_FRAGMENT_DEFINITIONS: `uniform float probeFromWorld;\n${GLSL}`, CUSTOM_REFLECTION: LIGHT };
  }
}
