// Makes a fresh app of app/ with a bundler, without configuration, serves it, and prints its address.
// node serve.mjs BUNDLER dev|build|strict SCENE; strict serves a build with a policy that allows nothing but files.
import { copyFileSync, cpSync, mkdirSync, readdirSync, readFileSync, renameSync, rmSync, writeFileSync } from "node:fs";
import { createServer } from "node:http";
import { dirname, extname, join } from "node:path";
import { fileURLToPath } from "node:url";

const [bundler, mode, scene] = process.argv.slice(2);
const here = dirname(fileURLToPath(import.meta.url));
const root = join(here, `${bundler}-${mode}`);
const out = join(root, "dist");
rmSync(root, { recursive: true, force: true });
cpSync(join(here, "app"), root, { recursive: true });
writeFileSync(join(root, "package.json"), JSON.stringify({ name: "app", private: true, type: "module" }));
mkdirSync(join(root, "public"));
copyFileSync(scene, join(root, "public", "scene.cogs"));
renameSync(join(root, "count_workers.js"), join(root, "public", "count_workers.js"));

const TYPES = { ".html": "text/html", ".js": "text/javascript", ".cogs": "application/octet-stream" };

const POLICY = {
  "Content-Security-Policy": "default-src 'self'; script-src 'self' 'wasm-unsafe-eval'; worker-src 'self'; img-src data:",
};

/** Serve the built app as a server of static files does. */
async function serveOut() {
  const server = createServer(({ url }, response) => {
    const name = url === "/" ? "index.html" : decodeURIComponent(url.split("?")[0]);
    const type = { "Content-Type": TYPES[extname(name)] ?? "application/octet-stream" };
    try {
      const body = readFileSync(join(out, name));
      response.writeHead(200, { ...type, ...(mode === "strict" && POLICY) }).end(body);
    } catch (error) {
      if (error.code !== "ENOENT") throw error;
      response.writeHead(404).end();
    }
  });
  await new Promise((done) => server.listen(0, "127.0.0.1", done));
  return `http://127.0.0.1:${server.address().port}/`;
}

/** The page and its public files, for bundlers that bundle scripts alone. */
function copyPage() {
  mkdirSync(out, { recursive: true });
  copyFileSync(join(root, "index.html"), join(out, "index.html"));
  for (const name of readdirSync(join(root, "public"))) copyFileSync(join(root, "public", name), join(out, name));
}

const bundlers = {
  async vite() {
    const { build, createServer: createVite } = await import(bundler);
    if (mode !== "dev") {
      await build({ root, logLevel: "warn" });
      return serveOut();
    }
    const server = await createVite({ root, server: { port: 0, host: "127.0.0.1" } });
    await server.listen();
    return server.resolvedUrls.local[0];
  },
  async webpack() {
    const { default: webpack } = await import("webpack");
    const options = {
      mode: mode === "dev" ? "development" : "production",
      context: root,
      entry: "./main.js",
      output: { path: out, filename: "main.js" },
      performance: false,
    };
    const stats = await new Promise((resolve, reject) =>
      webpack(options, (error, result) => (error ? reject(error) : resolve(result))),
    );
    if (stats.hasErrors() || stats.hasWarnings()) throw new Error(stats.toString());
    copyPage();
    return serveOut();
  },
  async esbuild() {
    const { build, context } = await import("esbuild");
    const options = { entryPoints: [join(root, "main.js")], bundle: true, format: "esm", outdir: out };
    copyPage();
    if (mode !== "dev") {
      const { warnings } = await build({ ...options, minify: true });
      if (warnings.length > 0) throw new Error(JSON.stringify(warnings));
      return serveOut();
    }
    const served = await (await context(options)).serve({ servedir: out, host: "127.0.0.1" });
    return `http://127.0.0.1:${served.port}/`;
  },
  async rollup() {
    const { rollup } = await import("rollup");
    const { nodeResolve } = await import("@rollup/plugin-node-resolve");
    const bundle = await rollup({ input: join(root, "main.js"), plugins: [nodeResolve()] });
    await bundle.write({ dir: out, format: "es" });
    copyPage();
    return serveOut();
  },
  async none() {
    // A script of the page alone, with an import map.
    const map = { imports: { cogsplat: "./cogsplat/cogsplat.js", "cogsplat/viewer": "./cogsplat/element.js" } };
    const page = readFileSync(join(root, "index.html"), "utf8");
    const script = `<script type="importmap">${JSON.stringify(map)}</script>\n    <script type="module"`;
    copyPage();
    writeFileSync(join(out, "index.html"), page.replace('<script type="module"', script));
    cpSync(join(here, "node_modules", "cogsplat", "dist"), join(out, "cogsplat"), { recursive: true });
    copyFileSync(join(root, "main.js"), join(out, "main.js"));
    return serveOut();
  },
};

console.log(`address: ${await bundlers[bundler.replace(/\d+$/, "")]()}`);
