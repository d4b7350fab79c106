/** The look of the parts that are loaded when they are asked for, inside the viewer's shadow. */
export const EXTRAS_STYLE = `
.panel :is(label, .row) { display: grid; grid-template-columns: 1fr 150px; align-items: center; gap: 8px; margin: 7px 0; }
.panel select, .panel input:not([type=checkbox]) { font: inherit; width: 100%; min-height: 28px; accent-color: var(--accent); }
.panel input[type=checkbox] { justify-self: end; width: 18px; height: 18px; accent-color: var(--accent); }
.panel table { width: 100%; margin-top: 8px; border-collapse: collapse; color: var(--soft); font-variant-numeric: tabular-nums; }
.panel td + td { text-align: right; color: var(--ink); }
.panel .row span { display: flex; gap: 6px; }
.panel details { margin-top: 8px; color: var(--soft); }
kbd { font: inherit; padding: 0 5px; border: 1px solid var(--edge); border-radius: 5px; color: var(--ink); }
.strip { flex: none; display: flex; gap: 8px; padding: 8px; overflow-x: auto; justify-content: safe center; }
.strip button { flex: none; padding: 0 0 5px; border: 2px solid transparent; border-radius: 8px; background: none; cursor: pointer; font-size: 12px; line-height: 1.3; color: var(--soft); overflow: hidden; }
.strip button[aria-pressed=true] { border-color: var(--accent); color: var(--ink); }
.strip canvas { position: static; width: 128px; height: 80px; margin-bottom: 4px; cursor: inherit; }
@media (pointer: coarse) { .keys { display: none; } }
@container (max-width: 480px) { .strip canvas { width: 96px; height: 72px; } }
.bar { position: absolute; left: 50%; top: 12px; translate: -50%; display: flex; align-items: center; gap: 10px; max-width: calc(100% - 24px); padding: 5px 6px 5px 14px;
  pointer-events: auto; font-variant-numeric: tabular-nums; white-space: nowrap; }
.bar button { flex: none; min-height: 32px; padding: 0 12px; border: 1px solid var(--edge); border-radius: 8px; background: none; cursor: pointer; }
.measuring canvas { cursor: crosshair; }
.measuring canvas:focus-visible ~ .overlay::after { content: "+"; position: absolute; left: 50%; top: 50%; translate: -50% -50%; color: #fff; font-size: 24px; text-shadow: 0 0 3px #000; }
.dot { position: absolute; left: -6px; top: -6px; width: 12px; height: 12px; border: 2px solid #fff; border-radius: 50%; background: var(--accent); box-shadow: 0 0 4px #000a; }
.pin { position: absolute; left: -13px; top: -13px; min-width: 26px; height: 26px; padding: 0 6px; border: 2px solid #fff; border-radius: 13px; background: #16181dd9; color: #fff;
  font-size: 13px; line-height: 1; pointer-events: auto; cursor: pointer; box-shadow: 0 1px 5px #0008; }
.pin::after { content: ""; position: absolute; inset: -10px; }
.pin[aria-expanded=true] { background: var(--accent); }
.pin.covered { opacity: .45; }
.measured { position: absolute; left: 0; top: -1px; height: 2px; background: #fff; box-shadow: 0 0 3px #000; transform-origin: 0 1px; }
`;
