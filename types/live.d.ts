// What the server sends over the socket of a page; app/line/live makes it.

type Person = [name: string, role: string];
type Setpoint = [raw: number | null, decimals: number | null];

/** The fields of a group: texts, also of numbers, and two lists. Empty: not known. */
interface Fields {
  /** Unix time, seconds. */
  at?: string;
  /** Ages, seconds. */
  stale_after?: string;
  offline_after?: string;
  setpoint?: Setpoint;
  here?: Person[];
  abnormal?: string;
  blocked?: string;
  counts?: string;
  level?: string;
  rank?: string;
  link?: string;
  mode?: string;
  sound?: string;
  sound_at?: string;
  verdict?: string;
  [field: string]: string | Setpoint | Person[] | undefined;
}
/** What a page knows of GROUP.FIELD. */
type Known<K> = (K extends `${string}.setpoint` ? Setpoint : string) | undefined;
type Groups = Record<string, Fields>;
type Listener = (fields: Fields, changed: Fields) => void;

/** A frame on a bus. */
interface Frame {
  at: number;
  direction: "in" | "out";
  hex: string;
  meaning: string;
  valid: boolean;
}

/** `digest`: of what a page is rendered with now; `n`: the number of a message, `p`: of the one before; `t`: Unix time, seconds. */
type LiveMessage =
  | { is: "snapshot"; digest: string; n: number; t: number; f: Groups }
  | { is: "changes"; p: number; n: number; t: number; f: Groups }
  | { is: "lines"; f: Groups }
  | { is: "frames"; frames: Frame[] };
