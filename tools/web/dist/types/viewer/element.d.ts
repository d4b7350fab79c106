import { type SceneSource } from "./scene_view.js";
import type { ViewerHandle, ViewerPose, ViewerStatistics } from "./viewer_handle.js";
import { type ViewerWorkers } from "./viewer_workers.js";
/**
 * `<cogsplat-viewer src="scene.cogs">`: a scene to look at, on any page, any number of times.
 *
 * | attribute | meaning |
 * |---|---|
 * | `src` | URL of a `.cogs` file or of a PLY of splats; set it anew to show another scene |
 * | `against` | URL of a second one to compare with, left of a line that can be moved |
 * | `label` | what the scene is called, by assistive technology as well; the file's name by default |
 * | `against-label` | what the second one is called; its file's name by default |
 * | `background` | a CSS colour behind the splats; black by default |
 * | `sh-degree` | highest SH degree that is drawn, 0 to 3 |
 * | `level` | of a scene with levels, the one that is drawn, 0 the coarsest, or a place between two; that of the picture's size by default |
 * | `splat-budget` | most splats in memory; 1,500,000 by default where fingers are the pointer |
 * | `order` | `view`: what is looked at is fetched first and, in a scene larger than its budget, takes the place of other things; `file`: the first chunks of the file; by default `view` where the file was cut into cells |
 * | `pixel-ratio` | most device pixels for a CSS pixel; 2 by default |
 * | `resolution` | `full` draws all pixels of moving and growing pictures too, where graphics are slow |
 * | `fill-holes` | `off` shows holes between splats while the scene arrives |
 * | `controls` | `none` shows no buttons |
 *
 * It fires `cogsplat-change` when `statistics` change. Leaving the page ends its workers and gives all memory back.
 */
export declare class CogsplatViewer extends HTMLElement implements ViewerHandle {
    static readonly observedAttributes: string[];
    /** How workers are started: from the programs beside this one, by default. */
    static workers: ViewerWorkers | undefined;
    private readonly shadow;
    private scene;
    private panel;
    private strip;
    private divide;
    private abort;
    private source;
    private otherSource;
    private error;
    private pose;
    private fills;
    private quiet;
    get statistics(): ViewerStatistics;
    get view(): ViewerPose | undefined;
    set view(view: ViewerPose | undefined);
    get fillHoles(): boolean;
    set fillHoles(fills: boolean);
    /** Show a scene: a URL, or a file. */
    load(source: SceneSource): Promise<void>;
    /** Show a second scene left of a line that can be moved; undefined ends that. */
    compare(source: SceneSource | undefined): Promise<void>;
    connectedCallback(): void;
    disconnectedCallback(): void;
    attributeChangedCallback(name: string, before: string | null, value: string | null): void;
    private get root();
    private find;
    private apply;
    private listen;
    private togglePanel;
    private toggleStrip;
    private closeAll;
    private toggleFullScreen;
    /** Show how far the scene has come. */
    private changed;
    private lastState;
    private entered;
    private nameScenes;
    private failed;
    /** Show a sentence, or take it away; `again` offers to load the scene once more. */
    private say;
}
/** Make `<cogsplat-viewer>` known to the page; a second copy of this program leaves it to the first. */
export declare function defineViewer(): void;
declare global {
    interface HTMLElementTagNameMap {
        "cogsplat-viewer": CogsplatViewer;
    }
}
