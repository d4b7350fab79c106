// Every entry point as its documentation uses it, against the newest versions of the renderers.
import { GaussianSplattingMesh, Quaternion, type Scene } from "@babylonjs/core";
import * as spark from "@sparkjsdev/spark";
import { DecoderPool, StreamedScene } from "cogsplat";
import { streamToBabylon } from "cogsplat/babylon";
import { folders } from "cogsplat/folders";
import { drawBySpec as drawPlayCanvasBySpec, streamToPlayCanvas } from "cogsplat/playcanvas";
import { drawBySpec, streamToSpark } from "cogsplat/spark";
import { streamToThree } from "cogsplat/three";
import { CogsplatViewer, type ViewerHandle } from "cogsplat/viewer";
import { Visit } from "cogsplat/visit";
import "cogsplat/worker";
import * as pc from "playcanvas";
import * as THREE from "three";

export async function open(url: string): Promise<StreamedScene> {
  return StreamedScene.open(url, { folders, service: (index) => new DecoderPool(index, { workers: 2 }) });
}

export async function inThree(scene: StreamedScene, world: THREE.Scene): Promise<THREE.Mesh> {
  const { mesh, done, dispose } = streamToThree(scene, THREE, { onChange: () => undefined });
  world.add(mesh);
  await done;
  dispose();
  return mesh;
}

export async function inSpark(scene: StreamedScene, world: THREE.Scene, renderer: THREE.WebGLRenderer): Promise<void> {
  const splatRenderer = new spark.SparkRenderer({ renderer, accumExtSplats: true });
  drawBySpec(splatRenderer, scene);
  world.add(splatRenderer);
  const { mesh, done } = streamToSpark(scene, spark, { degree: 2 });
  world.add(mesh);
  const own: spark.SplatMesh = mesh;
  own.opacity = 0.5;
  await done;
}

export async function inPlayCanvas(scene: StreamedScene, app: pc.Application): Promise<void> {
  drawPlayCanvasBySpec(pc, app, scene);
  const { resource, rotation, position, done } = streamToPlayCanvas(scene, pc, app.graphicsDevice, { application: app });
  const entity = new pc.Entity();
  entity.addComponent("gsplat", { resource });
  entity.setLocalRotation(...rotation);
  entity.setLocalPosition(...position);
  await done;
}

export async function inBabylon(scene: StreamedScene, world: Scene): Promise<GaussianSplattingMesh> {
  const { mesh, done } = streamToBabylon(scene, { GaussianSplattingMesh, Quaternion }, world);
  await done;
  return mesh;
}

export async function byTheView(scene: StreamedScene): Promise<void> {
  const visit = await Visit.begin(scene, { format: "packed", splatBudget: 1000 });
  for await (const change of visit.changes()) if (change.kind === "rows") change.packed?.words.at(0);
}

export function element(): ViewerHandle {
  const viewer: CogsplatViewer = document.createElement("cogsplat-viewer");
  viewer.setAttribute("src", "scene.cogs");
  return viewer;
}
