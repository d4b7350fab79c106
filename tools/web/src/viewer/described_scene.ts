import type { Description } from "../container/description.js";
import { Annotations } from "./annotations.js";
import { PathPlayer } from "./camera_path.js";
import { element, icon } from "./page_parts.js";
import { Sky } from "./sky.js";
import type { Stage } from "./stage.js";

const PLAY = "M8 5.5v13l11-6.5z";
const PAUSE = "M8 5.5v13M16 5.5v13";

/** Shows what a description has in the scene itself: annotations, camera path and sky. */
export class DescribedScene {
  private readonly annotations: Annotations;
  private readonly play: HTMLButtonElement | undefined;
  private player: PathPlayer | undefined;
  private isPlaying = false;
  private sky: Sky | undefined;

  constructor(
    private readonly stage: Stage,
    private readonly description: Description,
  ) {
    const { path, annotations } = description;
    this.annotations = new Annotations(stage, annotations);
    if (path !== undefined) {
      this.player = new PathPlayer(path);
      this.play = element("button", "", icon(PLAY));
      this.play.addEventListener("click", () => this.togglePlay());
      stage.tools.prepend(this.play);
      this.showPlay();
    }
  }

  /** Show the sky behind the splats. */
  async showSky(picture: Blob): Promise<void> {
    const { scene } = this.stage;
    const bitmap = await createImageBitmap(picture);
    this.sky = new Sky(scene.gl, bitmap, this.description.sky?.rotation, scene.axes);
    scene.show({ sky: this.sky.draw });
  }

  /** Give the sky to another description of the same scene. */
  moveSky(other: DescribedScene): void {
    other.sky = this.sky;
    this.sky = undefined;
    this.stage.scene.show({ sky: other.sky?.draw });
  }

  /** Show the card of an annotation, by its number from 0; undefined closes the card. */
  showAnnotation(number: number | undefined): void {
    this.annotations.show(number);
  }

  drawn(): void {
    this.annotations.drawn(this.stage.projection());
  }

  rested(): void {
    void this.annotations.rested();
  }

  /** Follow the end of a motion. */
  motionEnded(): void {
    this.isPlaying = false;
    this.showPlay();
  }

  remove(): void {
    this.annotations.remove();
    this.play?.remove();
    if (this.sky === undefined) return;
    this.stage.scene.show({ sky: undefined });
    this.sky.close();
  }

  private togglePlay(): void {
    const { scene } = this.stage;
    if (this.isPlaying) scene.camera.endMotion(true);
    else {
      scene.camera.move(this.player!.motion());
      this.isPlaying = true;
      this.showPlay();
    }
  }

  private showPlay(): void {
    const { play, isPlaying } = this;
    if (play === undefined) return;
    play.replaceChildren(icon(isPlaying ? PAUSE : PLAY));
    play.ariaLabel = play.title = isPlaying ? "Pause the camera path" : "Play the camera path";
  }
}
