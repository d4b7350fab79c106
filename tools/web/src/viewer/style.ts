/** The look of the viewer, inside its shadow. Colours follow the system's light or dark scheme. */
export const STYLE = `
:host { display: block; position: relative; width: 100%; min-height: 160px; aspect-ratio: 16 / 9; overflow: hidden; contain: strict; container-type: size;
  color-scheme: light dark; --glass: light-dark(#fffe, #16181dee); --ink: light-dark(#16181d, #f3f4f6);
  --soft: light-dark(#5a6270, #a3abb8); --edge: light-dark(#0002, #fff2); --accent: light-dark(#0b63ce, #6db3ff);
  background: #000; color: var(--ink); font: 14px/1.45 system-ui, sans-serif; }
:host([hidden]) { display: none; }
* { box-sizing: border-box; }
canvas { position: absolute; inset: 0; width: 100%; height: 100%; display: block; touch-action: none; outline-offset: -3px;
  cursor: grab; }
.embedded canvas { touch-action: pan-x pan-y; }
canvas:active { cursor: grabbing; }
:focus-visible { outline: 2px solid var(--accent); }
button { font: inherit; color: inherit; }
.glass { background: var(--glass); border: 1px solid var(--edge); border-radius: 12px; backdrop-filter: blur(12px); }
.loading { position: absolute; inset: 0; display: grid; place-content: center; justify-items: center; gap: 14px;
  background: #000; color: #d6dae1; text-align: center; padding: 24px; pointer-events: none; transition: opacity .35s, visibility .35s; }
.shown .loading, .failed .loading { opacity: 0; visibility: hidden; }
.failed:not(.shown) .foot { display: none; }
.poster { position: absolute; inset: 0; width: 100%; height: 100%; object-fit: cover; cursor: default; }
.loading:has(.poster:not([hidden])) > :is(.spinner, #hint) { display: none; }
.start { position: relative; width: 76px; height: 76px; padding: 20px; border: 0; border-radius: 50%; background: #000a; color: #fff; cursor: pointer; pointer-events: auto; box-shadow: 0 0 0 2px #fff8; }
.start svg { fill: currentColor; }
.waiting .spinner, .waiting #hint, .waiting .foot { display: none; }
.toast { position: absolute; left: 50%; top: 50%; translate: -50% -50%; width: max-content; max-width: calc(100% - 24px); padding: 8px 14px; text-align: center; text-wrap: balance; overflow-wrap: anywhere;
  opacity: 0; visibility: hidden; transition: opacity .25s, visibility .25s; pointer-events: none; }
.toast.shown { opacity: 1; visibility: visible; }
.overlay { position: absolute; inset: 0; overflow: hidden; pointer-events: none; }
.spinner { width: 34px; height: 34px; border-radius: 50%; border: 3px solid #fff3; border-top-color: #fff; animation: turn 1s linear infinite; }
.empty .spinner { display: none; }
@keyframes turn { to { transform: rotate(1turn); } }
.line { position: absolute; left: 0; right: 0; bottom: 0; height: 3px; background: #fff2; transition: opacity .6s; }
.line > div { height: 100%; width: 100%; background: var(--accent); transform: scaleX(0); transform-origin: left; }
.lower { position: absolute; inset: 12px 12px 14px; display: flex; flex-direction: column; justify-content: flex-end; gap: 12px; pointer-events: none; }
.lower > .glass, .tools { pointer-events: auto; }
.foot { flex: none; display: flex; flex-flow: row-reverse wrap-reverse; align-items: center; gap: 8px; }
output { text-wrap: balance; margin-right: auto; padding: 5px 11px; font-variant-numeric: tabular-nums; transition: opacity .6s; }
.quiet .line, .quiet output, .empty .line, .empty output, .failed .line { opacity: 0; }
.tools { flex: none; display: flex; gap: 2px; padding: 3px; }
.tools button, .close { width: 38px; height: 38px; padding: 8px; border: 0; border-radius: 9px; background: none; cursor: pointer; }
.tools button:hover, .tools button[aria-expanded=true], .close:hover { background: var(--edge); }
svg { width: 100%; height: 100%; display: block; fill: none; stroke: currentColor; stroke-width: 1.8; stroke-linecap: round; stroke-linejoin: round; }
.message { align-self: center; width: min(440px, 100%); min-height: 0; overflow: auto; margin-block: auto; padding: 18px 20px; }
.shown .message { margin-top: 0; margin-bottom: 0; }
.message h2 { margin: 0 0 4px; font-size: 16px; }
.message p { margin: 0; color: var(--soft); overflow-wrap: anywhere; }
.message button { margin-top: 12px; min-height: 36px; padding: 0 14px; border: 1px solid var(--edge); border-radius: 9px; background: none; cursor: pointer; }
.divide { position: absolute; top: 0; bottom: 0; width: 40px; margin-left: -20px; cursor: ew-resize; touch-action: none; }
.divide::before { content: ""; position: absolute; left: 19px; top: 0; bottom: 0; width: 2px; background: #fff; box-shadow: 0 0 6px #0008; }
.divide::after { content: "⇔"; position: absolute; left: 2px; top: calc(50% - 18px); width: 36px; height: 36px; line-height: 34px; text-align: center;
  border-radius: 50%; background: #fff; color: #222; box-shadow: 0 1px 6px #0008; }
.name { position: absolute; top: 12px; padding: 4px 10px; pointer-events: none; max-width: 45%; overflow: hidden; text-overflow: ellipsis; white-space: nowrap; }
.name.left { left: 12px; } .name.right { right: 12px; }
.over::after { content: "Drop to show · with Shift to compare"; position: absolute; inset: 12px; display: grid; place-content: center; border: 2px dashed #fff; border-radius: 14px; color: #fff; background: #0008; pointer-events: none; }
.panel { align-self: flex-end; width: min(310px, 100%); min-height: 0; overflow: auto; padding: 14px 16px; }
.panel .wide { width: 100%; min-height: 34px; margin-top: 4px; border: 1px solid var(--edge); border-radius: 8px; background: none; cursor: pointer; }
.panel h2 { margin: 0 0 8px; font-size: 15px; }
.caption { position: absolute; left: 12px; top: 12px; max-width: min(420px, calc(100% - 24px)); padding: 6px 12px; text-align: left; pointer-events: auto; cursor: pointer; }
.caption > * { display: block; overflow: hidden; text-overflow: ellipsis; white-space: nowrap; }
.caption span { font-size: 12px; color: var(--soft); }
:host([controls=none]) .caption, :has(> .name.left:not([hidden])) .caption, .measuring .caption { display: none; }
.about h2, .about p, .card h2, .card p { overflow-wrap: anywhere; }
.about .text, .card p { margin: 0 0 8px; white-space: pre-line; }
.about .rights { margin: 0 0 4px; font-size: 12px; color: var(--soft); }
.about h3 { margin: 12px 0 2px; font-size: 13px; }
.about ul { margin: 0; padding: 0; list-style: none; }
.about .wide { padding: 6px 12px; text-align: left; overflow-wrap: anywhere; }
.about, .card { flex: 0 1 auto; position: relative; align-self: flex-start; }
:is(.about, .card) h2 { padding-right: 36px; }
:has(.about:not([hidden])) > .overlay > .caption { visibility: hidden; }
:is(.about, .card) .close { position: absolute; right: 6px; top: 6px; font-size: 20px; line-height: 1; }
@container (max-width: 480px) { .panel { width: 100%; } }
@container (max-width: 766px) and (min-height: 480px) { :has(> .overlay > .caption) > .lower { top: 74px; } }
@container (max-width: 766px) and (max-height: 480px) { :has(.panel:not([hidden])) > .overlay > .caption { visibility: hidden; } }
[hidden] { display: none !important; }
@media (pointer: coarse) { .tools button, .close { width: 44px; height: 44px; padding: 10px; } }
@media (prefers-reduced-motion: reduce) { * { transition: none !important; } .spinner { animation-duration: 4s; } }
`;
