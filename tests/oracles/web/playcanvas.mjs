// A mirror ball in PlayCanvas.
import * as pc from 'playcanvas';
import { ReflectionProbes } from '/export/splatprobe-playcanvas.js';

export async function render(canvas, { position: [x, y, z], radius, distance }) {
  const app = new pc.Application(canvas, { graphicsDeviceOptions: { preserveDrawingBuffer: true, antialias: false } });
  app.graphicsDevice.maxPixelRatio = 1;
  const material = new pc.StandardMaterial();
  Object.assign(material, { useMetalness: true, metalness: 1, gloss: 1 });
  material.update();
  const sphere = new pc.SphereGeometry({ radius, latitudeBands: 128, longitudeBands: 256 });
  const ball = new pc.Entity('ball');
  const instance = new pc.MeshInstance(pc.Mesh.fromGeometry(app.graphicsDevice, sphere), material);
  ball.addComponent('render', { meshInstances: [instance] });
  ball.setPosition(x, y, z);
  app.root.addChild(ball);
  const probes = await ReflectionProbes.load('/export/probes.json', app.graphicsDevice);
  probes.apply([instance]);
  const camera = new pc.Entity('camera');
  camera.addComponent('camera', {
    projection: pc.PROJECTION_ORTHOGRAPHIC, orthoHeight: radius, nearClip: distance / 2, farClip: 2 * distance,
    clearColor: new pc.Color(0, 0, 0), toneMapping: pc.TONEMAP_LINEAR,
  });
  camera.setPosition(x, y, z + distance);
  app.root.addChild(camera);
  // Two frames, of which the first is empty; in software, more would keep the page from answering.
  app.autoRender = false;
  app.start();
  for (let frame = 0; frame < 2; frame++) {
    app.renderNextFrame = true;
    await new Promise((resolve) => app.once('frameend', resolve));
  }
}
