// Which values there are, and what each is called.
export class Catalogue {
  /** @param {CatalogueUnit[]} units @param {Record<string, string>} words by the name of a value */
  constructor(units, words) {
    this.units = new Map(units.map((unit) => [unit.key, unit]));
    this.words = words;
  }

  /** @param {string} name @returns {[CatalogueUnit | undefined, string]} */
  split(name) {
    const cut = name.lastIndexOf("/");
    return [this.units.get(name.slice(0, cut)), name.slice(cut + 1)];
  }

  /** @param {string} name */
  has(name) {
    const [unit, value] = this.split(name);
    return unit !== undefined && value in this.words;
  }

  /** @param {number} count */
  first(count) {
    return [...this.units.keys()].slice(0, count).map((key) => `${key}/actual`);
  }

  /** @param {string} name */
  title(name) {
    const [unit, value] = this.split(name);
    return `${unit?.name} · ${unit?.labels[value] || this.words[value]}`;
  }

  /** What each of some lines is called beside it: its unit alone where all show the same value.
   * @param {string[]} names */
  labels(names) {
    const isSame = new Set(names.map((name) => this.split(name)[1])).size === 1;
    return names.map((name) => (isSame ? (this.split(name)[0]?.name ?? name) : this.title(name)));
  }

  /** The values, and one of each unit beside theirs on its line: what happens there is seen here.
   * @param {string[]} names */
  withNeighbors(names) {
    const keys = [...this.units.keys()];
    /** @param {string} key */
    const bus = (key) => key.slice(0, key.lastIndexOf("/"));
    const shown = new Set(names.map((name) => name.slice(0, name.lastIndexOf("/"))));
    const beside = keys.filter((key, i) => [keys[i - 1], keys[i + 1]].some((other) => shown.has(other) && bus(other) === bus(key)));
    return [...names, ...beside.map((key) => `${key}/actual`)];
  }

  /** A unit by its name, or a bus. @param {string} bus @param {number | null} unit */
  place(bus, unit) {
    return unit === null ? bus : (this.units.get(`${bus}/${unit}`)?.name ?? `${bus}/${unit}`);
  }
}
