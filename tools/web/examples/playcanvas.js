// A COGS scene in PlayCanvas: playcanvas.html?scene=URL, with &rules=own by the engine's own rules instead of those of SPEC 8.7
import { DecoderPool, StreamedScene } from "cogsplat";
import { drawBySpec, streamToPlayCanvas } from "cogsplat/playcanvas";
import * as pc from "playcanvas";
import { firstPose } from "./pose.js";

const canvas = document.querySelector("canvas");
const output = document.querySelector("output");
addEventListener("error", ({ error }) => (output.textContent = error.message));
const parameters = new URLSearchParams(location.search);
const url = parameters.get("scene") ?? "scene.cogs";

const app = new pc.Application(canvas, { graphicsDeviceOptions: { antialias: false } });
app.setCanvasFillMode(pc.FILLMODE_FILL_WINDOW);
app.setCanvasResolution(pc.RESOLUTION_AUTO);
addEventListener("resize", () => app.resizeCanvas());
app.start();
const camera = new pc.Entity();
camera.addComponent("camera", { clearColor: new pc.Color(0, 0, 0), nearClip: 0.2, farClip: 1000 });
app.root.addChild(camera);

const scene = await StreamedScene.open(url, { service: (index) => new DecoderPool(index) });
const shown = streamToPlayCanvas(scene, pc, app.graphicsDevice, {
  application: app,
  leastRows: parameters.get("rules") === "own" ? 0 : 65_536,
  degree: Number(parameters.get("degree") ?? 3),
  onUpload: (rows) => (output.textContent = `${rows.toLocaleString()} of ${scene.info.splats.toLocaleString()} splats`),
});
const entity = new pc.Entity();
entity.addComponent("gsplat", { resource: shown.resource });
entity.setLocalRotation(...shown.rotation);
entity.setLocalPosition(...shown.position);
app.root.addChild(entity);
if (parameters.get("rules") !== "own") drawBySpec(pc, app, scene, entity);
look(firstPose(scene.info, Math.PI / 4));

/** Put the camera where a pose of `pose.js` says. */
function look({ position, right, up, back, fieldOfView }) {
  const axes = new pc.Mat4();
  axes.data.set([...right, 0, ...up, 0, ...back, 0, 0, 0, 0, 1]);
  camera.setLocalPosition(...position);
  camera.setLocalRotation(new pc.Quat().setFromMat4(axes));
  camera.camera.fov = (fieldOfView * 180) / Math.PI;
}

// For programs that drive this page.
const example = {
  scene,
  look,
  frames: 0,
  complete: false,
  app,
  entity,
  resource: shown.resource,
  dispose() {
    entity.destroy();
    shown.dispose();
  },
};
globalThis.example = example;
app.on("frameend", () => example.frames++);
await shown.done;
example.complete = true;
