// Stream a scene from a URL, for Node and for a page: what comes of it, in words that tests compare.

const ARRAYS = ["means", "scales", "quats", "opacities", "sh0", "shN"];

async function digestOf(splats) {
  const bytes = new Uint8Array(await new Blob(ARRAYS.map((name) => splats[name])).arrayBuffer());
  const hash = new Uint8Array(await crypto.subtle.digest("SHA-256", bytes));
  return Array.from(hash, (byte) => byte.toString(16).padStart(2, "0")).join("");
}

async function allRows(cogsplat, scene) {
  const last = new Map();
  for await (const update of scene.stream()) last.set(update.firstRow, update.splats);
  const parts = [...last.keys()].sort((a, b) => a - b).map((row) => last.get(row));
  return cogsplat.concatenate(parts, scene.info.shDegree);
}

async function opened(cogsplat, url, options) {
  const scene = await cogsplat.StreamedScene.open(url, options);
  try {
    return await allRows(cogsplat, scene);
  } catch (error) {
    if (error.code !== "source-changed") throw error;
    return allRows(cogsplat, await scene.reopen());
  }
}

/** Open a scene and stream all chunks, from the beginning once more where the file changed meanwhile. */
export async function outcomeOf(cogsplat, url, seconds) {
  const options = { retry: { pause: 10 }, http: { longestPause: 1000 } };
  const work = opened(cogsplat, url, options).then(
    async (splats) => ({ sha256: await digestOf(splats) }),
    (error) => ({ error: error.name, code: error.code, message: error.message }),
  );
  let timer;
  const late = new Promise((resolve) => (timer = setTimeout(() => resolve({ error: "hang" }), 1000 * seconds)));
  const outcome = await Promise.race([work, late]);
  clearTimeout(timer);
  return outcome;
}
