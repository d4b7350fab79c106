export declare const WASM_DIGITS: string;
