// Reads URLs, one a line, and writes what comes of streaming each, as JSON, one a line.
// node fetch_scenes.mjs COGSPLAT.js SECONDS

import { createInterface } from "node:readline";
import { pathToFileURL } from "node:url";
import { outcomeOf } from "./fetch_scene.mjs";

const [module, seconds] = process.argv.slice(2);
const cogsplat = await import(pathToFileURL(module).href);
for await (const url of createInterface({ input: process.stdin })) {
  console.log(JSON.stringify(await outcomeOf(cogsplat, url, Number(seconds))));
}
process.exit(0);
