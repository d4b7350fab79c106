// Bundles build/src: the library, the program of its workers and the viewer, without a dependency.
// node scripts/bundle.mjs FOLDER
import { copyFileSync, readFileSync, rmSync } from "node:fs";
import { gzipSync } from "node:zlib";
import { build } from "esbuild";

const [folder] = process.argv.slice(2);
rmSync(folder, { recursive: true, force: true });
const common = {
  outdir: folder,
  bundle: true,
  format: "esm",
  target: "es2022",
  minify: true,
  charset: "utf8",
  legalComments: "inline",
  banner: { js: "/*! cogsplat, Apache-2.0 */" },
};
await build({
  ...common,
  entryPoints: {
    cogsplat: "build/src/index.js",
    worker: "build/src/workers/worker.js",
    viewer: "build/src/viewer/page.js",
    viewer_extras: "build/src/viewer/viewer_extras.js",
    viewer_worker: "build/src/viewer/viewer_worker.js",
    spark: "build/src/adapters/spark.js",
    playcanvas: "build/src/adapters/playcanvas.js",
  },
  // The viewer imports them when they are asked for.
  external: ["./viewer_extras.js"],
});
// They throw the errors of the library that they are used with.
const errorsOfLibrary = {
  name: "errors of the library",
  setup: ({ onResolve }) => onResolve({ filter: /\/errors\.js$/ }, () => ({ path: "./cogsplat.js", external: true })),
};
await build({
  ...common,
  entryPoints: { folders: "build/src/loader/folders.js", visit: "build/src/loader/visit.js" },
  plugins: [errorsOfLibrary],
});
for (const file of ["viewer.html", "viewer.css"]) copyFileSync(`viewer/${file}`, `${folder}/${file}`);
for (const file of [
  "cogsplat.js",
  "folders.js",
  "visit.js",
  "worker.js",
  "viewer.js",
  "viewer_extras.js",
  "viewer_worker.js",
]) {
  const bytes = readFileSync(`${folder}/${file}`);
  console.log(`${folder}/${file}: ${bytes.length} bytes, ${gzipSync(bytes, { level: 9 }).length} gzipped`);
}
