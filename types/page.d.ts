// What the templates promise the scripts of static/js: parts of a page, attributes, and what events are about.

/** Parts that every page has on which the script that looks for them has started. */
interface Parts {
  ".gone": HTMLElement;
  ".gone__box": HTMLElement;
  "[data-frames]": HTMLElement;
  "[data-gone-cause]": HTMLElement;
  "[data-gone-since]": HTMLElement;
  "[data-gone-for]": HTMLElement;
  "[data-keypad-label]": HTMLElement;
  "[data-keypad-limits]": HTMLElement;
  '[data-pad="-"]': HTMLButtonElement;
  "[data-review-end]": HTMLElement;
  "[data-review-act]": HTMLButtonElement;
  "[data-move=live]": HTMLElement;
  "[role=status]": HTMLElement;
  "[type=submit]": HTMLButtonElement;
  "input:not([type=hidden], [type=checkbox])": HTMLInputElement;
}

/** The same by id. */
interface PartsById {
  main: HTMLElement;
  faceplate: HTMLElement;
  verdict: HTMLElement;
  announcement: HTMLElement;
  keypad: HTMLTemplateElement;
  review: HTMLDialogElement;
  "review-body": HTMLElement;
}

/** The same by the end of the name of an attribute, data-sound-…; on most pages without what sets it. */
interface SoundParts {
  strip: HTMLElement;
  word: HTMLElement;
  text: HTMLElement;
  press: HTMLElement;
  state: HTMLElement | null;
  on: HTMLInputElement;
  from: HTMLSelectElement;
  lost: HTMLInputElement;
  test: HTMLElement;
}

/** The kind of element that a selector finds, where it finds one. */
interface Kinds extends HTMLElementTagNameMap {
  "[data-counts-act]": HTMLButtonElement;
  "[data-follows]": HTMLInputElement;
  "[data-new]": HTMLInputElement;
  "[data-pictures]": HTMLInputElement;
  "[data-tick]": HTMLInputElement;
  "[data-typed]": HTMLInputElement;
  "input.input--number:enabled": HTMLInputElement;
}

/** A script looks for HTML elements, unless it names another kind. */
interface ParentNode {
  querySelector<K extends keyof Parts>(selectors: K): Parts[K];
  querySelector<K extends keyof Kinds>(selectors: K): Kinds[K] | null;
  querySelector<E extends Element = HTMLElement>(selectors: string): E | null;
  querySelectorAll<K extends keyof Kinds>(selectors: K): NodeListOf<Kinds[K]>;
  querySelectorAll<E extends Element = HTMLElement>(selectors: string): NodeListOf<E>;
}
interface Element {
  matches<K extends keyof Kinds>(selectors: K): this is Kinds[K];
  closest<K extends keyof Kinds>(selectors: K): Kinds[K] | null;
  closest<E extends Element = HTMLElement>(selectors: string): E | null;
}
interface Document {
  getElementById<K extends keyof PartsById>(id: K): PartsById[K];
}
interface Performance {
  getEntriesByType(type: "navigation"): PerformanceNavigationTiming[];
}

/** Attributes of an element that was looked for by them. */
interface DOMStringMap {
  live: string;
  liveBit: string;
  liveIs: string;
  liveVar: string;
  liveTitle: string;
  liveHref: string;
  liveValue: string;
  livePath: string;
  liveQuality: string;
  liveStep: string;
  unit: string;
  age: string;
  follows: string;
  redraw: string;
  reload: string;
  tenMinutes: string;
  alarmTrend: string;
  came: string;
  trace: string;
  undo: string;
  countsOne: string;
  countsMany: string;
  preset: string;
  typed: string;
  watchUnit: string;
  wordOn: string;
  wordOff: string;
  padFor: string;
}

/** An event that bubbles from an element of the page. */
type On<E, T = HTMLElement> = E & { readonly target: T };

interface DocumentEventMap {
  change: On<Event>;
  click: On<PointerEvent>;
  focusin: On<FocusEvent>;
  keydown: On<KeyboardEvent>;
  focusout: FocusEvent & { readonly relatedTarget: HTMLElement | null };
  pointerdown: On<PointerEvent, HTMLElement>;
  submit: On<SubmitEvent, HTMLFormElement>;
  wheel: On<WheelEvent>;
  "lineside:changed": CustomEvent;
  "lineside:taken": CustomEvent<HTMLFormElement | null>;
  "lineside:unknown": CustomEvent<HTMLFormElement | null>;
  "lineside:done": CustomEvent<string>;
  "lineside:found": CustomEvent;
  "lineside:idle": CustomEvent;
  "lineside:lines": CustomEvent<string[]>;
  "lineside:lost": CustomEvent;
  "lineside:reported": CustomEvent;
  "htmx:after:swap": CustomEvent<{ ctx: HtmxRequest }>;
  "htmx:before:request": CustomEvent<{ ctx: HtmxRequest }>;
  "htmx:config:request": CustomEvent<{ ctx: HtmxRequest }>;
  "htmx:error": CustomEvent<{ ctx?: HtmxRequest }>;
  "htmx:finally:request": CustomEvent<{ ctx: HtmxRequest }>;
}
interface HTMLElementEventMap {
  click: On<PointerEvent>;
  input: On<InputEvent, HTMLInputElement>;
  keydown: On<KeyboardEvent>;
  submit: On<SubmitEvent, HTMLFormElement>;
}
interface WindowEventMap {
  keyup: On<KeyboardEvent>;
  pointerup: On<PointerEvent>;
}

/** Writes a value into an element that is bound to it. */
type Write = (value: string) => void;

/** An element that shows a unit or its age; `marked`: the quality that it has been given. */
interface Shown {
  element: HTMLElement;
  unit: string;
  marked?: string;
}

/** Where a person was at work: an element, the id of a part around it, a selector for its successor there. */
interface Place {
  element: HTMLElement;
  home?: string;
  twin: string;
  /** What it is in, from the nearest. */
  around: HTMLElement[];
}

/** What htmx does for one element, as far as the scripts read or change it. */
interface HtmxRequest {
  readonly sourceElement: HTMLElement;
  readonly target: string | HTMLElement | null;
  readonly request: { action: string; readonly method: string; readonly headers: Record<string, string>; readonly body: FormData; readonly submitter?: HTMLElement | null };
}

// --- sound --------------------------------------------------------------------------------------------------

interface SoundSettings {
  on: boolean;
  /** The least important priority that has sound. */
  from: string;
  /** Whether a lost server has. */
  lost: boolean;
}

/** The priority that sounds, empty for none; `at`: when the newest alarm began or the tones were played, seconds. */
interface Sounding {
  priority: string;
  at: number;
}

/** Silenced here: alarms up to a time, and this loss of the server. */
interface Muted {
  until: number;
  lost: boolean;
}

// --- the trends page ---------------------------------------------------------------------------------------

interface PartsById {
  trends: HTMLElement & { dataset: { catalogue: string; valueWords: string; shiftStarts: string; locale: string } };
  "trend-add": HTMLFormElement & { readonly elements: { unit: HTMLSelectElement; value: HTMLSelectElement } };
  "trend-alarms-count": HTMLElement;
  "trend-alarms-list": HTMLElement;
  "trend-announcement": HTMLElement;
  "trend-events-count": HTMLElement;
  "trend-events-list": HTMLElement;
  "trend-exact": HTMLFormElement & { readonly elements: { from: HTMLInputElement; to: HTMLInputElement } };
  "trend-fault": HTMLElement;
  "trend-at": HTMLElement;
  "trend-brighten": HTMLButtonElement;
  "trend-remove": HTMLButtonElement;
  "trend-compare": HTMLSelectElement;
  "trend-legend": HTMLElement;
  "trend-marks": HTMLInputElement;
  "trend-note": (HTMLFormElement & { readonly elements: NoteFields }) | null;
  "trend-note-result": HTMLElement;
  "trend-notes-count": HTMLElement;
  "trend-notes-list": HTMLElement;
  "trend-past": HTMLElement;
  "trend-save": HTMLFormElement & { readonly elements: { query: HTMLInputElement } };
  "trend-picture": HTMLElement;
  "trend-plot": HTMLElement;
  "trend-scale": HTMLSelectElement;
  "trend-span": HTMLElement;
  "trend-summary": HTMLElement;
  "trend-unread": HTMLElement;
  "trend-values": HTMLTableSectionElement;
  "trend-copied": HTMLElement;
  "trend-copy": HTMLButtonElement;
  "trend-link": HTMLInputElement;
  "trend-words": HTMLTemplateElement & { dataset: TrendWords };
  "time-a": HTMLElement;
  "time-b": HTMLElement;
  "time-difference": HTMLElement;
}

/** Of the form for a note. */
interface NoteFields {
  time: HTMLInputElement;
  unit: HTMLSelectElement;
  text: HTMLTextAreaElement;
}

/** The texts of the page, data-… of its template. */
interface TrendWords extends DOMStringMap {
  copied: string;
  only: string;
  onlyThis: string;
  pastEmpty: string;
  active: string;
  alarms: string;
  backwards: string;
  malformed: string;
  before: string;
  every: string;
  fault: string;
  full: string;
  hole: string;
  holes: string;
  language: string;
  late: string;
  latest: string;
  live: string;
  more: string;
  noResponse: string;
  none: string;
  norun: string;
  notes: string;
  nothing: string;
  off: string;
  on: string;
  per: string;
  remove: string;
  run: string;
  stored: string;
  unreadAfter: string;
  unreadBefore: string;
  yesterday: string;
}
