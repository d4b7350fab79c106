import { render } from "./notebook.js";
declare const _default: {
    render: typeof render;
};
export default _default;
