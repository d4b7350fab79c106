/** What stands in the viewer's shadow. */
export declare const MARKUP: string;
