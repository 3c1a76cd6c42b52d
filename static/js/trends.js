// The trends page begins here: first its picture, then what every page has.
import { TrendsPage } from "./trends-page.js";

const REST_WAITS_MS = 1000;

const first = new TrendsPage().start();
// What every page has comes after the picture, or without it when the history is slow.
Promise.race([first, new Promise((late) => setTimeout(late, REST_WAITS_MS))]).finally(() => import("./main.js"));
