const icon = (path: string): string => `<svg viewBox="0 0 24 24" aria-hidden="true"><path d="${path}"/></svg>`;

/** Markup of the viewer's shadow root. */
export const MARKUP = `
<div id="root" class="empty">
  <canvas tabindex="0" role="application" aria-roledescription="3D scene"></canvas>
  <div class="overlay" id="overlay"></div>
  <div class="loading" id="loading"><img id="poster" alt="" hidden /><div class="spinner"></div><div id="hint" aria-hidden="true"></div>
    <button class="start" id="start" aria-label="Show the scene" hidden>${icon("M8 5.5v13l11-6.5z")}</button></div>
  <div class="divide" id="divide" role="slider" tabindex="0" aria-label="Where the two scenes meet" aria-valuemin="0" aria-valuemax="100" hidden></div>
  <div class="glass name left" id="otherName" hidden></div>
  <div class="glass name right" id="sceneName" hidden></div>
  <div class="line" id="line" role="progressbar" aria-label="Loading" aria-valuemin="0" aria-valuemax="100"><div></div></div>
  <div class="toast glass" id="toast" aria-live="polite"></div>
  <div class="lower">
  <div class="message glass" id="message" role="alert" hidden><h2></h2><p></p><button id="again">Try again</button></div>
  <div class="strip glass" id="strip" role="group" aria-label="The scene after parts of its file" hidden></div>
  <form class="panel glass" id="panel" aria-label="Settings" hidden>
    <h2>Settings</h2>
    <label>Reflections (SH degree) <select name="degree"></select></label>
    <label hidden id="levelRow">Level <select name="level"></select></label>
    <label>Splats <input name="budget" type="range" min="1" max="100" value="100" /></label>
    <label>Background <select name="background">
      <option value="#000000">Black</option><option value="#808080">Grey</option><option value="#ffffff">White</option><option value="custom">Other …</option>
    </select></label>
    <label hidden id="customRow">Colour <input name="custom" type="color" value="#204060" /></label>
    <label>Movement <select name="movement"><option value="orbit">Around the scene</option><option value="fly">Through the scene</option></select></label>
    <button class="wide" type="button" id="measure">Measure</button>
    <label>Turn by itself <input name="turns" type="checkbox" /></label>
    <label>Connection <select name="rate">
      <option value="Infinity">As it is</option><option value="50">50 Mbit/s</option><option value="20">20 Mbit/s</option><option value="5">5 Mbit/s</option><option value="1">1 Mbit/s</option>
    </select></label>
    <button class="wide" type="button" id="reload">Load again</button>
    <label>Fill holes while loading <input name="fill" type="checkbox" checked /></label>
    <label>Compare with a file <button class="wide" type="button" id="choose">Choose …</button></label>
    <label>Statistics <input name="statistics" type="checkbox" /></label>
    <table id="statistics" hidden><tbody></tbody></table>
    <details class="keys"><summary>Keys</summary>
      <kbd>←</kbd> <kbd>→</kbd> <kbd>↑</kbd> <kbd>↓</kbd> turn · <kbd>W</kbd> <kbd>A</kbd> <kbd>S</kbd> <kbd>D</kbd> <kbd>Q</kbd> <kbd>E</kbd> fly ·
      <kbd>+</kbd> <kbd>−</kbd> nearer, farther · <kbd>R</kbd> first view · <kbd>F</kbd> full screen · <kbd>G</kbd> settings · <kbd>T</kbd> film strip · <kbd>M</kbd> measure · double click: nearer</details>
  </form>
  <div class="foot">
  <div class="tools glass" id="tools" role="toolbar" aria-label="Viewer">
    <button id="reset" title="First view (R)" aria-label="First view">${icon("M4 11.5 12 5l8 6.5M6.5 10v9h11v-9")}</button>
    <button id="film" title="Film strip (T)" aria-label="Film strip" aria-expanded="false">${icon("M4 5h16v14H4zM8 5v14M16 5v14M4 9.7h4M4 14.3h4M16 9.7h4M16 14.3h4")}</button>
    <button id="settings" title="Settings (G)" aria-label="Settings" aria-expanded="false">${icon("M4 7h9M17 7h3M4 17h3M11 17h9M13 4.5v5M7 14.5v5")}</button>
    <button id="full" title="Full screen (F)" aria-label="Full screen">${icon("M4 9V4h5M20 9V4h-5M4 15v5h5M20 15v5h-5")}</button>
  </div>
  <output class="glass" id="progress"></output>
  </div>
  </div>
  <input id="file" type="file" accept=".cogs,.ply" hidden />
</div>`;
