/** Markup of the fields of the settings. */
export const PANEL_MARKUP = `
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
  <button class="wide" type="button" id="copyView">Copy this view</button>
  <label>Turn by itself <input name="turns" type="checkbox" /></label>
  <label>Connection <select name="rate">
    <option value="Infinity">As it is</option><option value="50">50 Mbit/s</option><option value="20">20 Mbit/s</option><option value="5">5 Mbit/s</option><option value="1">1 Mbit/s</option>
  </select></label>
  <button class="wide" type="button" id="reload">Load again</button>
  <label>Fill holes while loading <input name="fill" type="checkbox" checked /></label>
  <label>Compare with a file <button class="wide" type="button" id="choose">Choose …</button></label>
  <div class="row">SuperSplat's settings <span><button class="wide" type="button" id="export">Export</button><button class="wide" type="button" id="import">Import</button></span></div>
  <input id="settingsFile" type="file" accept=".json" hidden />
  <label>Statistics <input name="statistics" type="checkbox" /></label>
  <table id="statistics" hidden><tbody></tbody></table>
  <details class="keys"><summary>Keys</summary>
    <kbd>←</kbd> <kbd>→</kbd> <kbd>↑</kbd> <kbd>↓</kbd> turn · <kbd>W</kbd> <kbd>A</kbd> <kbd>S</kbd> <kbd>D</kbd> <kbd>Q</kbd> <kbd>E</kbd> fly ·
    <kbd>+</kbd> <kbd>−</kbd> nearer, farther · <kbd>R</kbd> first view · <kbd>C</kbd> copy the view · <kbd>F</kbd> full screen · <kbd>G</kbd> settings · <kbd>T</kbd> film strip · <kbd>M</kbd> measure · double click: nearer</details>
`;
