// A COGS scene in Spark: spark.html?scene=URL, with &rules=own by the renderer's own rules instead of those of SPEC 8.7
import * as spark from "@sparkjsdev/spark";
import { DecoderPool, StreamedScene } from "cogsplat";
import { drawBySpec, streamToSpark } from "cogsplat/spark";
import * as THREE from "three";
import { firstPose } from "./pose.js";

const canvas = document.querySelector("canvas");
const output = document.querySelector("output");
addEventListener("error", ({ error }) => (output.textContent = error.message));
const parameters = new URLSearchParams(location.search);
const url = parameters.get("scene") ?? "scene.cogs";

const renderer = new THREE.WebGLRenderer({ canvas, antialias: false });
const world = new THREE.Scene();
const camera = new THREE.PerspectiveCamera(50, 1, 0.2, 1000);
// Without `accumExtSplats` Spark packs every picture's splats coarser than they were uploaded. A splat reaches to where it
// adds 1/255, which is 3.33 standard deviations, and large ones fill the picture.
const reach = { maxStdDev: 3.33, minAlpha: 1 / 255, maxPixelRadius: 4096, clipXY: 3 };
const splatRenderer = new spark.SparkRenderer({ renderer, accumExtSplats: true, ...reach });
world.add(splatRenderer);

const scene = await StreamedScene.open(url, { service: (index) => new DecoderPool(index) });
const shown = streamToSpark(scene, spark, {
  degree: Number(parameters.get("degree") ?? 3),
  onUpload: (rows) => (output.textContent = `${rows.toLocaleString()} of ${scene.info.splats.toLocaleString()} splats`),
});
if (parameters.get("rules") !== "own") drawBySpec(splatRenderer, scene, shown.mesh);
world.add(shown.mesh);
look(firstPose(scene.info, THREE.MathUtils.degToRad(camera.fov)));
renderer.setAnimationLoop(() => {
  const { clientWidth: width, clientHeight: height } = canvas;
  if (canvas.width !== width || canvas.height !== height) {
    renderer.setSize(width, height, false);
    camera.aspect = width / height;
    camera.updateProjectionMatrix();
  }
  renderer.render(world, camera);
  example.frames++;
});

/** Put the camera where a pose of `pose.js` says. */
function look({ position, right, up, back, fieldOfView }) {
  const axes = new THREE.Matrix4().makeBasis(
    new THREE.Vector3(...right),
    new THREE.Vector3(...up),
    new THREE.Vector3(...back),
  );
  camera.position.set(...position);
  camera.quaternion.setFromRotationMatrix(axes);
  camera.fov = THREE.MathUtils.radToDeg(fieldOfView);
  camera.updateProjectionMatrix();
}

// For programs that drive this page.
const example = {
  scene,
  look,
  frames: 0,
  complete: false,
  dispose: shown.dispose,
  mesh: shown.mesh,
  world,
  splatRenderer,
};
globalThis.example = example;
await shown.done;
example.complete = true;
