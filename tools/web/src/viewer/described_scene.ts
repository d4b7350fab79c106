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
<<<<<<< HEAD
    const { path, annotations } = description;
=======
    const { title, text, credits, licence, date, views, path, annotations, background } = description;
    const rights = [credits, licence].filter((part) => part);
    this.about = element("section", "panel about glass");
    this.about.ariaLabel = "About this scene";
    this.about.hidden = true;
    const list = (name: string, buttons: readonly HTMLElement[]): Node[] =>
      buttons.length === 0
        ? []
        : [element("h3", "", name), element("ul", "", ...buttons.map((button) => element("li", "", button)))];
    const { close } = this;
    close.ariaLabel = "Close";
    close.addEventListener("click", () => this.toggleAbout());
    this.about.append(
      close,
      element("h2", "", title ?? "About this scene"),
      ...(text === undefined ? [] : [element("p", "text", text)]),
      ...[...rights, date].filter((line) => line).map((line) => element("p", "rights", line!)),
      ...list(
        "Views",
        views.map((view) => {
          const button = element("button", "wide", view.name);
          button.addEventListener("click", () => stage.flyTo(view));
          return button;
        }),
      ),
      ...list(
        "Annotations",
        annotations.map((annotation, i) => {
          const button = element("button", "wide", `${i + 1}: ${annotation.title}`);
          button.addEventListener("click", () => this.annotations.show(i));
          return button;
        }),
      ),
    );
    stage.foot.before(this.about);
    if (title !== undefined || this.about.childElementCount > 2) {
      this.caption = element("button", "caption glass", element("b", "", title ?? "About this scene"));
      if (rights.length > 0) this.caption.append(element("span", "", rights.join(" · ")));
      this.caption.ariaExpanded = "false";
      this.caption.addEventListener("click", () => this.toggleAbout());
      stage.overlay.append(this.caption);
    }
>>>>>>> 72df6ff7 (Break long texts of the viewer between numbers and at the licence, so that poses and credits stay readable on phones)
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
