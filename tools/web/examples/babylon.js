// A COGS scene in Babylon.js: babylon.html?scene=URL
import { DecoderPool, StreamedScene } from "cogsplat";
import { streamToBabylon } from "cogsplat/babylon";
import { firstPose } from "./pose.js";

const { BABYLON } = globalThis;
const canvas = document.querySelector("canvas");
const output = document.querySelector("output");
addEventListener("error", ({ error }) => (output.textContent = error.message));
const parameters = new URLSearchParams(location.search);
const url = parameters.get("scene") ?? "scene.cogs";

const engine = new BABYLON.Engine(canvas, false);
const world = new BABYLON.Scene(engine);
world.useRightHandedSystem = parameters.get("hand") === "right";
world.clearColor = new BABYLON.Color4(0, 0, 0, 1);
const camera = new BABYLON.FreeCamera("camera", BABYLON.Vector3.Zero(), world);
camera.minZ = 0.2;
camera.maxZ = 1000;

const scene = await StreamedScene.open(url, { service: (index) => new DecoderPool(index) });
const shown = streamToBabylon(scene, BABYLON, world, {
  degree: Number(parameters.get("degree") ?? 3),
  onUpload: (rows) => (output.textContent = `${rows.toLocaleString()} of ${scene.info.splats.toLocaleString()} splats`),
});
look(firstPose(scene.info, camera.fov));
engine.runRenderLoop(() => {
  const { clientWidth: width, clientHeight: height } = canvas;
  if (canvas.width !== width || canvas.height !== height) engine.setSize(width, height);
  world.render();
  example.frames++;
});

/** Put the camera where a pose of `pose.js` says; z points the other way in a left-handed world. */
function look({ position, up, back, fieldOfView }) {
  const sign = world.useRightHandedSystem ? 1 : -1;
  const vector = ([x, y, z]) => new BABYLON.Vector3(x, y, sign * z);
  camera.position = vector(position);
  camera.upVector = vector(up);
  camera.setTarget(camera.position.subtract(vector(back)));
  camera.fov = fieldOfView;
}

// For programs that drive this page.
const example = { scene, look, frames: 0, complete: false, dispose: shown.dispose, mesh: shown.mesh, world };
globalThis.example = example;
await shown.done;
example.complete = true;
