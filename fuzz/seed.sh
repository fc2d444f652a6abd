#!/usr/bin/env bash
# Fills corpus/<target> from the fixtures, from a bake of the demo where the tool is built, and from $SPLATPROBE_DATA.
set -euo pipefail
cd "$(dirname "$0")"
fixtures=../tests/fixtures
targets=(ply packed spz sog gltf usd texture exr environment job manifest placement)
for target in "${targets[@]}"; do mkdir -p "corpus/$target"; done

cp ../tests/fixtures/one_scene/*.ply corpus/ply/
cp ../tests/fixtures/one_scene/scene-2.ksplat corpus/packed/
cp ../tests/fixtures/one_scene/*.spz corpus/spz/
cp ../tests/fixtures/one_scene/scene.sog corpus/sog/
cp ../pipelines/demo/lamp.glb corpus/gltf/
for file in $fixtures/usd/*.usd* $fixtures/usd_meshes/*.usd*; do
  cp "$file" "corpus/usd/$(basename "$(dirname "$file")")-$(basename "$file")"
done
cp ../tests/common/*.ktx2 $fixtures/usd_meshes/*.png corpus/texture/
cp ../pipelines/demo/demo.json corpus/job/

# Small files that mutations get further in.
python3 - "$fixtures/one_scene" ../pipelines/demo/lamp.glb <<'PY'
import base64, gzip, json, os, pathlib, re, struct, sys, zipfile
one, lamp = pathlib.Path(sys.argv[1]), pathlib.Path(sys.argv[2])
def write(name, data):
    (pathlib.Path('corpus') / name).write_bytes(data if isinstance(data, bytes) else data.encode())

head, body = (one / 'scene.ply').read_bytes().split(b'end_header\n', 1)
write('ply/four.ply', head.replace(b'vertex 1000', b'vertex 4') + b'end_header\n' + body[:4 * 59 * 4])
names = 'x y z f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3'.split()
text = 'ply\nformat ascii 1.0\nelement vertex 2\n' + ''.join(f'property float {n}\n' for n in names) + 'end_header\n'
write('ply/ascii.ply', text + '0 0 -2 1 .5 0 2 -1 -1 -1 1 0 0 0\n1 0 -2 1 .5 0 2 -1 -3 -1 .5 .5 0 0\n')
head, body = (one / 'scene.compressed.ply').read_bytes().split(b'end_header\n', 1)
chunks, vertices, harmonics = body[:4 * 72], body[4 * 72:4 * 72 + 16000], body[4 * 72 + 16000:]
head = head.replace(b'chunk 4', b'chunk 1').replace(b'vertex 1000', b'vertex 4').replace(b'sh 1000', b'sh 4')
write('ply/four.compressed.ply', head + b'end_header\n' + chunks[:72] + vertices[:64] + harmonics[:4 * 45])

splat = b''.join(struct.pack('<6f8B', k, .5, -2, .1, .2, .3, 200, 100, 50, 255, 255, 128, 128, 100 + k) for k in range(4))
write('packed/four.splat', splat)

for name in ['scene-v3.spz', 'scene-v4.spz']:
    data = (one / name).read_bytes()
    if data[:2] == b'\x1f\x8b':
        data = gzip.decompress(data)
        count, degree = struct.unpack_from('<IB', data, 8)
        parts, at, kept = [9, 1, 3, 3, 4, 3 * ((degree + 1) ** 2 - 1)], 16, data[:8] + struct.pack('<I', 4) + data[12:16]
        for size in parts:
            kept, at = kept + data[at:at + 4 * size], at + count * size
        write('spz/four-unpacked', kept)

with zipfile.ZipFile(one / 'scene.sog') as bundle:
    for name in bundle.namelist():
        write('sog/' + name, bundle.read(name))
    write('texture/sog.webp', bundle.read('means_l.webp'))
    meta = json.loads(bundle.read('meta.json'))
bound = {'min': [-9, -9, -9], 'max': [9, 9, 9]}
piece = lambda file: {'bound': bound, 'lods': {'0': {'file': file, 'offset': 0, 'count': 500}, '1': {'file': file, 'offset': 500, 'count': 9}}}
write('sog/lod-meta.json', json.dumps({'version': 1, 'count': 1018, 'counts': [1000, 18], 'lodLevels': 2,
    'filenames': ['a/meta.json', 'b/meta.json'], 'tree': {'bound': bound, 'children': [piece(0), piece(1)]}}))

def parts(glb):
    length = struct.unpack_from('<I', glb, 12)[0]
    return json.loads(glb[20:20 + length]), glb[28 + length:]
def embedded(document, binary):
    document['buffers'] = [{'byteLength': len(binary), 'uri': 'data:application/octet-stream;base64,' + base64.b64encode(binary).decode()}]
    return json.dumps(document)
write('gltf/lamp.gltf', embedded(*parts(lamp.read_bytes())))
document, binary = parts((one / 'scene.glb').read_bytes())
small = b''
for accessor in document['accessors']:
    view = document['bufferViews'][accessor['bufferView']]
    assert 'byteStride' not in view
    start = view.get('byteOffset', 0) + accessor.get('byteOffset', 0)
    size = {5126: 4, 5123: 2, 5121: 1}[accessor['componentType']] * {'SCALAR': 1, 'VEC3': 3, 'VEC4': 4}[accessor['type']]
    view['byteOffset'], view['byteLength'], accessor['count'] = len(small), 4 * size, 4
    accessor.pop('byteOffset', None)
    small += binary[start:start + 4 * size]
write('gltf/splats.gltf', embedded(document, small))
text = json.dumps(document | {'buffers': [{'byteLength': len(small)}]}).encode()
text += b' ' * (-len(text) % 4)
small += b'\0' * (-len(small) % 4)
header = struct.pack('<4sIIII', b'glTF', 2, 28 + len(text) + len(small), len(text), 0x4e4f534a)
write('gltf/splats.glb', header + text + struct.pack('<II', len(small), 0x4e4942) + small)
corners = struct.pack('<9f', -1, -1, -2, 1, -1, -2, 0, 1, -2)
extensions = {f'KHR_materials_{name}': {} for name in ['unlit', 'ior', 'specular', 'clearcoat', 'sheen', 'transmission', 'volume',
    'anisotropy', 'iridescence', 'emissive_strength', 'dispersion']}
write('gltf/extensions.gltf', embedded({'asset': {'version': '2.0'}, 'scene': 0, 'scenes': [{'nodes': [0, 1]}],
    'nodes': [{'mesh': 0, 'skin': 0, 'weights': [.5]}, {'extensions': {'KHR_lights_punctual': {'light': 0}}, 'rotation': [0, 0, 0, 1]}],
    'skins': [{'joints': [1]}], 'extensionsUsed': list(extensions) + ['KHR_lights_punctual', 'KHR_texture_transform', 'EXT_mesh_gpu_instancing'],
    'extensions': {'KHR_lights_punctual': {'lights': [{'type': 'spot', 'intensity': 9, 'range': 5, 'spot': {'outerConeAngle': .7}}]}},
    'meshes': [{'primitives': [{'attributes': {'POSITION': 0, 'NORMAL': 0}, 'targets': [{'POSITION': 0}], 'mode': 4, 'material': 0}]}],
    'materials': [{'alphaMode': 'MASK', 'extensions': extensions}], 'bufferViews': [{'buffer': 0, 'byteLength': 36}],
    'accessors': [{'bufferView': 0, 'componentType': 5126, 'count': 3, 'type': 'VEC3',
        'sparse': {'count': 1, 'indices': {'bufferView': 0, 'componentType': 5121}, 'values': {'bufferView': 0}}}]}, corners))

write('texture/two.tga', struct.pack('<3B5s4H2B', 0, 0, 10, b'', 0, 0, 2, 2, 32, 8) + b'\x83abcd' + b'\0' * 8 + b'TRUEVISION-XFILE.\0')
write('environment/sky.hdr', b'#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 2 +X 4\n' + bytes(range(64, 96)))
run = b'\x02\x02\x00\x10' + 4 * b'\x90\x80'
write('environment/rle.hdr', b'#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 8 +X 16\n' + 8 * run)

write('placement/rooms', bytes([11]) + bytes(0 if x in (0, 6, 11) or z in (0, 11) and x != 3 else 15 - 2 * (x == 8) for z in range(12) for x in range(12)))
write('placement/slant', bytes([15]) + bytes(0x3f if abs(x - z) < 4 else 0 for z in range(16) for x in range(16)))
write('job/full.json', json.dumps({'splats': [{'path': 'a.ply', 'frame': 'rdf', 'crop': {'box': [0, 0, 0, 1, 1, 1]}, 'lod': 1}],
    'meshes': [{'path': 'b.glb', 'scene': '0', 'missingTexture': 'magenta'}], 'background': 'sky.exr', 'output': 'o', 'faceSize': 64,
    'placement': {'probes': [[1, 2, 3]], 'adaptive': 12, 'heights': [1.5]}, 'shard': '1/3', 'footprint': 'pixel', 'exposure': 1.5}))
PY

# A bake's images and manifests.
tool=../target/debug/splatprobe
if [ -x $tool ]; then
  scratch=$(mktemp -d)
  trap 'rm -r "$scratch"' EXIT
  $tool bake ../pipelines/demo/demo.json -o "$scratch/out" --face-size 8 --outputs strip,mips,latlong,latlong-hdr,moments --distance
  $tool bake ../pipelines/demo/demo.json -o "$scratch/float" --face-size 4 --outputs strip --pixel float
  $tool place --splats ../pipelines/demo/demo.ply -o "$scratch/placed" --max-probes 4 --held-out 4
  for file in "$scratch"/{out,float,placed}/manifest.json; do
    [ -e "$file" ] && cp "$file" "corpus/manifest/$(basename "$(dirname "$file")").json"
  done
  for file in "$scratch"/{out,float}/*/*.exr; do cp "$file" "corpus/exr/$(echo "${file#"$scratch/"}" | tr / -)"; done
  cp "$scratch"/out/*/latlong.hdr "$scratch"/out/*/latlong.exr corpus/environment/ 2> /dev/null || true
fi

if [ -n "${SPLATPROBE_DATA:-}" ]; then
  find "$SPLATPROBE_DATA/meshes" -size -20k \( -name '*.glb' -o -name '*.gltf' \) -exec cp --backup=numbered -t corpus/gltf {} +
  find "$SPLATPROBE_DATA" -size -8k \( -name '*.png' -o -name '*.jpg' -o -name '*.webp' \) | head -50 | tr '\n' '\0' | xargs -0 cp --backup=numbered -t corpus/texture
  find "$SPLATPROBE_DATA/usd" -size -60k -name '*.usd*' -exec cp --backup=numbered -t corpus/usd {} +
fi
chmod -R u+w corpus
du -s corpus/* | cat
