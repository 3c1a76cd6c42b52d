// Every page begins here.
import { rebind } from "./bind.js";
import * as live from "./live.js";
import * as quality from "./quality.js";
import * as strip from "./strip.js";
import * as review from "./review.js";
import * as setter from "./setter.js";
import * as trace from "./trace.js";
import * as people from "./people.js";

rebind();
quality.findUnits();
quality.start();
strip.start();
review.start();
setter.start();
trace.start();
people.start();
live.follow([...new Set([...document.querySelectorAll("[data-watch-unit]")].map((element) => element.dataset.watchUnit))]);
live.start();
document.addEventListener("lineside:changed", quality.findUnits);
document.addEventListener("lineside:found", quality.findUnits);
