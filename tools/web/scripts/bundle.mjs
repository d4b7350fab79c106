// Bundles build/src: the library, the programs of its workers, the viewer and the adapters, without a dependency.
// node scripts/bundle.mjs FOLDER
import { copyFileSync, readFileSync, rmSync } from "node:fs";
import { gzipSync } from "node:zlib";
import { build } from "esbuild";

const [folder] = process.argv.slice(2);
rmSync(folder, { recursive: true, force: true });
const common = {
  bundle: true,
  target: "es2022",
  minify: true,
  charset: "utf8",
  legalComments: "inline",
};
const modules = { ...common, outdir: folder, format: "esm", banner: { js: "/*! cogsplat, Apache-2.0 */" } };

// The viewer imports them when they are asked for.
const external = ["./viewer_extras.js"];

/** Return a program as a text, for workers that a bundler need not find; the page adds the kernels. */
async function programText(entryPoint) {
  const kernelsOfPage = {
    name: "kernels of the page",
    setup: ({ onLoad }) =>
      onLoad({ filter: /\/wasm_bytes\.js$/ }, () => ({
        contents: "export const WASM_DIGITS = self.cogsplatKernels;",
      })),
  };
  const { outputFiles } = await build({
    ...common,
    entryPoints: [entryPoint],
    format: "iife",
    write: false,
    plugins: [kernelsOfPage],
  });
  return JSON.stringify(outputFiles[0].text.trim());
}

// For pages without a bundler: the workers' programs are files of their own.
await build({
  ...modules,
  entryPoints: {
    worker: "build/src/workers/worker.js",
    viewer: "build/src/viewer/page.js",
    viewer_extras: "build/src/viewer/viewer_extras.js",
    viewer_worker: "build/src/viewer/viewer_worker.js",
    spark: "build/src/adapters/spark.js",
    playcanvas: "build/src/adapters/playcanvas.js",
  },
  external,
  define: { DECODER_TEXT: "undefined" },
});
// For bundlers: the workers' programs are in the modules too.
await build({
  ...modules,
  entryPoints: {
    cogsplat: "build/src/index.js",
    element: "build/src/viewer/package_entry.js",
    three: "build/src/adapters/three.js",
    babylon: "build/src/adapters/babylon.js",
  },
  define: {
    DECODER_TEXT: await programText("build/src/workers/worker.js"),
    VIEWER_TEXT: await programText("build/src/viewer/viewer_worker.js"),
    SORT_TEXT: await programText("build/src/viewer/sort_worker.js"),
  },
  external,
});
// They throw the errors of the library that they are used with.
const errorsOfLibrary = {
  name: "errors of the library",
  setup: ({ onResolve }) => onResolve({ filter: /\/errors\.js$/ }, () => ({ path: "./cogsplat.js", external: true })),
};
await build({
  ...modules,
  entryPoints: { folders: "build/src/loader/folders.js", visit: "build/src/loader/visit.js" },
  plugins: [errorsOfLibrary],
});
for (const file of ["viewer.html", "viewer.css"]) copyFileSync(`viewer/${file}`, `${folder}/${file}`);
const SIZED = [
  ...["cogsplat", "folders", "visit", "worker", "viewer", "viewer_extras", "viewer_worker", "element"],
  ...["three", "spark", "playcanvas", "babylon"],
];
for (const file of SIZED.map((name) => `${name}.js`)) {
  const bytes = readFileSync(`${folder}/${file}`);
  console.log(`${folder}/${file}: ${bytes.length} bytes, ${gzipSync(bytes, { level: 9 }).length} gzipped`);
}
