/** What a person is told of something that went wrong: a short title, and what can be done or what it means. */
export interface Sentence {
    readonly title: string;
    readonly detail: string;
}
/**
 * Describe an error to a person.
 *
 * @param shown - Whether a part of the scene is on the screen.
 */
export declare function describe(error: unknown, shown: boolean): Sentence;
