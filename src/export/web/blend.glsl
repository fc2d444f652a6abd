// The probes of a material. Positions and directions are in the manifest's frame. A uniform a line: PlayCanvas reads them so.
uniform samplerCube probeCube0;
uniform samplerCube probeCube1;
uniform samplerCube probeCube2;
uniform samplerCube probeCube3;
uniform float probeWeights[4];
uniform vec3 probeTakenAt[4];
uniform vec3 probeProxyMin[4];
uniform vec3 probeProxyMax[4];
uniform vec3 probeSh[9];
uniform float probeRoughestMip;

vec3 probeSample(samplerCube cube, int i, vec3 position, vec3 direction, float lod) {
  // All probes are looked up, so that nothing depends on derivatives or branches; most materials blend three.
  vec3 corrected = probeDirection(position, direction, probeTakenAt[i], probeProxyMin[i], probeProxyMax[i]);
  return textureLod(cube, probeLookUp(corrected), lod).rgb * probeWeights[i];
}

// What a surface of this perceptual roughness reflects from a direction.
vec3 probesRadiance(vec3 position, vec3 direction, float roughness) {
  float lod = roughness * probeRoughestMip;
  return probeSample(probeCube0, 0, position, direction, lod) + probeSample(probeCube1, 1, position, direction, lod)
    + probeSample(probeCube2, 2, position, direction, lod) + probeSample(probeCube3, 3, position, direction, lod);
}
