/** The look of the parts that are loaded when they are asked for, inside the viewer's shadow. */
export const EXTRAS_STYLE = `
.bar { position: absolute; left: 50%; top: 12px; translate: -50%; display: flex; align-items: center; gap: 10px; max-width: calc(100% - 24px); padding: 5px 6px 5px 14px;
  pointer-events: auto; font-variant-numeric: tabular-nums; white-space: nowrap; }
.bar button { flex: none; min-height: 32px; padding: 0 12px; border: 1px solid var(--edge); border-radius: 8px; background: none; cursor: pointer; }
.measuring canvas { cursor: crosshair; }
.measuring canvas:focus-visible ~ .overlay::after { content: "+"; position: absolute; left: 50%; top: 50%; translate: -50% -50%; color: #fff; font-size: 24px; text-shadow: 0 0 3px #000; }
.dot { position: absolute; left: -6px; top: -6px; width: 12px; height: 12px; border: 2px solid #fff; border-radius: 50%; background: var(--accent); box-shadow: 0 0 4px #000a; }
.measured { position: absolute; left: 0; top: -1px; height: 2px; background: #fff; box-shadow: 0 0 3px #000; transform-origin: 0 1px; }
`;
