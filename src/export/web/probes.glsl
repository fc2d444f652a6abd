// A probe's look-ups, in the manifest's frame.

// Cube maps lie as three.js, PlayCanvas and Babylon.js look them up.
vec3 probeLookUp(vec3 direction) {
  return vec3(-direction.x, direction.yz);
}

// From where the probe was taken to where the ray leaves its proxy box (Lagarde & Zanuttini 2012); not normalised.
vec3 probeDirection(vec3 position, vec3 direction, vec3 takenAt, vec3 proxyMin, vec3 proxyMax) {
  vec3 inside = clamp(position, proxyMin, proxyMax);
  vec3 exits = (mix(proxyMin, proxyMax, step(0.0, direction)) - inside) / direction;
  // Along an axis without movement a ray never leaves.
  exits = mix(exits, vec3(1e30), equal(direction, vec3(0.0)));
  return inside + direction * max(min(exits.x, min(exits.y, exits.z)), 0.0) - takenAt;
}

// Irradiance over pi, from the factors of irradianceFactors() in probes.js.
vec3 probeIrradiance(vec3 s[9], vec3 n) {
  vec3 sum = s[0] + s[1] * n.y + s[2] * n.z + s[3] * n.x + s[4] * (n.x * n.y) + s[5] * (n.y * n.z);
  return max(sum + s[6] * (3.0 * n.z * n.z - 1.0) + s[7] * (n.x * n.z) + s[8] * (n.x * n.x - n.y * n.y), 0.0);
}
