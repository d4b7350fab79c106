import type { ExtrasModule } from "./element.js";

let loaded: Promise<ExtrasModule> | undefined;

/** Run the program of the extras from its text, once; a policy must allow the script by its hash. */
export function extrasOfText(text: string): Promise<ExtrasModule> {
  loaded ??= new Promise((resolve, reject) => {
    const script = document.createElement("script");
    const taken = (event: Event): void => resolve((event as CustomEvent<ExtrasModule>).detail);
    document.addEventListener("cogsplat-extras", taken, { once: true });
    document.addEventListener("securitypolicyviolation", () => reject(new Error("the page's policy refuses it")), {
      once: true,
    });
    script.type = "module";
    script.textContent = text;
    document.head.append(script);
  });
  return loaded;
}
