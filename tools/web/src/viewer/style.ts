/** The look of the viewer, inside its shadow. Colours follow the system's light or dark scheme. */
export const STYLE = `
:host { display: block; position: relative; min-height: 160px; aspect-ratio: 16 / 9; overflow: hidden; contain: strict; container-type: size;
  color-scheme: light dark; --glass: light-dark(#fffe, #16181dee); --ink: light-dark(#16181d, #f3f4f6);
  --soft: light-dark(#5a6270, #a3abb8); --edge: light-dark(#0002, #fff2); --accent: light-dark(#0b63ce, #6db3ff);
  background: #000; color: var(--ink); font: 14px/1.45 system-ui, sans-serif; }
:host([hidden]) { display: none; }
* { box-sizing: border-box; }
canvas { position: absolute; inset: 0; width: 100%; height: 100%; display: block; touch-action: none; outline-offset: -3px;
  cursor: grab; }
canvas:active { cursor: grabbing; }
canvas:focus-visible, button:focus-visible, .divide:focus-visible { outline: 2px solid var(--accent); }
button { font: inherit; color: inherit; }
.glass { background: var(--glass); border: 1px solid var(--edge); border-radius: 12px; backdrop-filter: blur(12px); }
.loading { position: absolute; inset: 0; display: grid; place-content: center; justify-items: center; gap: 14px;
  background: #000; color: #d6dae1; text-align: center; padding: 24px; pointer-events: none; transition: opacity .35s, visibility .35s; }
.shown .loading, .failed .loading { opacity: 0; visibility: hidden; }
.failed:not(.shown) output { opacity: 0; }
.spinner { width: 34px; height: 34px; border-radius: 50%; border: 3px solid #fff3; border-top-color: #fff; animation: turn 1s linear infinite; }
.empty .spinner { display: none; }
@keyframes turn { to { transform: rotate(1turn); } }
.line { position: absolute; left: 0; right: 0; bottom: 0; height: 3px; background: #fff2; transition: opacity .6s; }
.line > div { height: 100%; width: 100%; background: var(--accent); transform: scaleX(0); transform-origin: left; }
output { text-wrap: balance; position: absolute; left: 12px; bottom: 14px; padding: 5px 11px; font-variant-numeric: tabular-nums; pointer-events: none;
  transition: opacity .6s; max-width: calc(100% - 24px); }
.quiet .line, .quiet output, .empty .line, .empty output, .failed .line { opacity: 0; }
.tools { position: absolute; right: 12px; bottom: 14px; display: flex; gap: 2px; padding: 3px; }
.tools button, .close { width: 38px; height: 38px; padding: 8px; border: 0; border-radius: 9px; background: none; cursor: pointer; }
.tools button:hover, .tools button[aria-expanded=true], .close:hover { background: var(--edge); }
svg { width: 100%; height: 100%; display: block; fill: none; stroke: currentColor; stroke-width: 1.8; stroke-linecap: round; stroke-linejoin: round; }
.panel { position: absolute; right: 12px; bottom: 70px; width: min(310px, calc(100% - 24px)); max-height: calc(100% - 84px); overflow: auto; padding: 14px 16px; }
.panel h2 { margin: 0 0 8px; font-size: 15px; }
.panel label { display: grid; grid-template-columns: 1fr 150px; align-items: center; gap: 8px; margin: 7px 0; }
.panel select, .panel input:not([type=checkbox]) { font: inherit; width: 100%; min-height: 28px; accent-color: var(--accent); }
.panel input[type=checkbox] { justify-self: end; width: 18px; height: 18px; accent-color: var(--accent); }
.panel .wide { width: 100%; min-height: 34px; margin-top: 4px; border: 1px solid var(--edge); border-radius: 8px; background: none; cursor: pointer; }
.panel table { width: 100%; margin-top: 8px; border-collapse: collapse; color: var(--soft); font-variant-numeric: tabular-nums; }
.panel td + td { text-align: right; color: var(--ink); }
.panel details { margin-top: 8px; color: var(--soft); }
kbd { font: inherit; padding: 0 5px; border: 1px solid var(--edge); border-radius: 5px; color: var(--ink); }
.message { position: absolute; left: 50%; top: 50%; transform: translate(-50%, -50%); width: min(440px, calc(100% - 32px)); padding: 18px 20px; }
.shown .message { top: auto; bottom: 74px; transform: translateX(-50%); }
.message h2 { margin: 0 0 4px; font-size: 16px; }
.message p { margin: 0; color: var(--soft); overflow-wrap: anywhere; }
.message button { margin-top: 12px; min-height: 36px; padding: 0 14px; border: 1px solid var(--edge); border-radius: 9px; background: none; cursor: pointer; }
.divide { position: absolute; top: 0; bottom: 0; width: 40px; margin-left: -20px; cursor: ew-resize; touch-action: none; }
.divide::before { content: ""; position: absolute; left: 19px; top: 0; bottom: 0; width: 2px; background: #fff; box-shadow: 0 0 6px #0008; }
.divide::after { content: "⇔"; position: absolute; left: 2px; top: calc(50% - 18px); width: 36px; height: 36px; line-height: 34px; text-align: center;
  border-radius: 50%; background: #fff; color: #222; box-shadow: 0 1px 6px #0008; }
.name { position: absolute; top: 12px; padding: 4px 10px; pointer-events: none; max-width: 45%; overflow: hidden; text-overflow: ellipsis; white-space: nowrap; }
.name.left { left: 12px; } .name.right { right: 12px; }
.strip { position: absolute; left: 12px; right: 12px; bottom: 70px; display: flex; gap: 8px; padding: 8px; overflow-x: auto; justify-content: safe center; }
.strip button { flex: none; padding: 0 0 5px; border: 2px solid transparent; border-radius: 8px; background: none; cursor: pointer; font-size: 12px; line-height: 1.3; color: var(--soft); overflow: hidden; }
.strip button[aria-pressed=true] { border-color: var(--accent); color: var(--ink); }
.strip canvas { position: static; width: 128px; height: 80px; margin-bottom: 4px; cursor: inherit; }
.over::after { content: "Drop to show · with Shift to compare"; position: absolute; inset: 12px; display: grid; place-content: center; border: 2px dashed #fff; border-radius: 14px; color: #fff; background: #0008; pointer-events: none; }
[hidden] { display: none !important; }
@media (pointer: coarse) { .tools button, .close { width: 44px; height: 44px; padding: 10px; } .keys { display: none; } }
@container (max-width: 480px) { .panel { left: 12px; width: auto; } output { bottom: 72px; } .strip { bottom: 134px; } .strip canvas { width: 96px; height: 72px; } }
@media (prefers-reduced-motion: reduce) { * { transition: none !important; } .spinner { animation-duration: 4s; } }
`;
