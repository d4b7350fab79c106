const icon = (path: string): string => `<svg viewBox="0 0 24 24" aria-hidden="true"><path d="${path}"/></svg>`;

/** Markup of the viewer's shadow root. */
export const MARKUP = `
<div id="root" class="empty">
  <canvas tabindex="0" role="application" aria-roledescription="3D scene"></canvas>
  <div class="overlay" id="overlay"></div>
  <div class="loading" id="loading"><img class="poster" id="poster" alt="" hidden /><div class="spinner"></div><div id="hint" aria-hidden="true"></div>
    <button class="start" id="start" aria-label="Show the scene" hidden>${icon("M8 5.5v13l11-6.5z")}</button></div>
  <div class="divide" id="divide" role="slider" tabindex="0" aria-label="Where the two scenes meet" aria-valuemin="0" aria-valuemax="100" hidden></div>
  <div class="glass name left" id="otherName" hidden></div>
  <div class="glass name right" id="sceneName" hidden></div>
  <div class="line" id="line" role="progressbar" aria-label="Loading" aria-valuemin="0" aria-valuemax="100"><div></div></div>
  <div class="toast glass" id="toast" aria-live="polite"></div>
  <div class="lower">
  <div class="message glass" id="message" role="alert" hidden><h2></h2><p></p><button id="again">Try again</button></div>
  <div class="foot">
  <div class="tools glass" id="tools" role="toolbar" aria-label="Viewer">
    <button id="reset" title="First view (R)" aria-label="First view">${icon("M4 11.5 12 5l8 6.5M6.5 10v9h11v-9")}</button>
    <button id="film" title="Film strip (T)" aria-label="Film strip" aria-expanded="false">${icon("M4 5h16v14H4zM8 5v14M16 5v14M4 9.7h4M4 14.3h4M16 9.7h4M16 14.3h4")}</button>
    <button id="settings" title="Settings (G)" aria-label="Settings" aria-expanded="false">${icon("M4 7h9M17 7h3M4 17h3M11 17h9M13 4.5v5M7 14.5v5")}</button>
    <button id="headset" title="View in VR" aria-label="View in VR" hidden>${icon("M3 9.5a2 2 0 0 1 2-2h14a2 2 0 0 1 2 2V16a2 2 0 0 1-2 2h-3l-2.5-3h-3L8 18H5a2 2 0 0 1-2-2z")}</button>
    <button id="full" title="Full screen (F)" aria-label="Full screen">${icon("M4 9V4h5M20 9V4h-5M4 15v5h5M20 15v5h-5")}</button>
  </div>
  <output class="glass" id="progress"></output>
  </div>
  </div>
  <input id="file" type="file" accept=".cogs,.ply" hidden />
</div>`;
