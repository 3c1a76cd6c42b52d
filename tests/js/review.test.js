// A review ends once its unit takes nothing from here any more, and states why.
import assert from "node:assert/strict";
import { test } from "node:test";
import { openPage } from "./page.js";

openPage({ words: { stoppedResponding: "no response", leftRemote: "local", wasBlocked: "blocked: {n}", moved: "now {n}", runMoved: "run",
  estopCame: "e-stop", estopWent: "no e-stop" } });
document.querySelector = () => null;
const { replace } = await import("../../static/js/bind.js");
const { whyNot, whyOver } = await import("../../static/js/review.js");
const UNIT = { link: "online", mode: "remote", blocked: "" };

test("a unit whose response is late has not stopped responding", () => {
  assert.equal(whyNot(UNIT), "");
  assert.equal(whyNot({ ...UNIT, link: "stale" }), "");
  assert.equal(whyNot({ ...UNIT, link: "offline" }), "no response");
});

test("a unit in LOCAL or blocked takes nothing", () => {
  assert.equal(whyNot({ ...UNIT, mode: "local" }), "local");
  assert.equal(whyNot({ ...UNIT, blocked: "belt off" }), "blocked: belt off");
});

test("a review of several ends once one of them takes nothing any more", () => {
  const row = { dataset: { watch: "line/6.commanded", was: "120.2", name: "Nip" } };
  replace({ "line/6": { ...UNIT, commanded: "120.2" } });
  assert.equal(whyOver(row, UNIT), "");
  assert.equal(whyOver(row, { ...UNIT, mode: "local" }), "Nip: local");
  replace({ "line/6": { ...UNIT, commanded: "118.0" } });
  assert.equal(whyOver(row, UNIT), "Nip: now 118.0");
});

test("a review ends once the inputs change on which the effect of a setpoint depends", () => {
  const row = { dataset: { watch: "line/6.commanded", was: "120.0", name: "Nip", signals: "10" } };
  replace({ "line/6": { ...UNIT, commanded: "120.0" } });
  assert.equal(whyOver(row, UNIT), "");
  assert.equal(whyOver(row, { ...UNIT, inputs: "1000001" }), "");
  assert.equal(whyOver(row, { ...UNIT, inputs: "1100001" }), "Nip: e-stop");
  assert.equal(whyOver(row, { ...UNIT, inputs: "0000001" }), "Nip: run");
  const held = { dataset: { ...row.dataset, signals: "11" } };
  assert.equal(whyOver(held, { ...UNIT, inputs: "1000001" }), "Nip: no e-stop");
});

test("a review of an output ends once another person has switched it", () => {
  const form = { dataset: { of: "line/6", watch: "line/6.outputs@1", was: "off", on: "on", off: "off" } };
  replace({ "line/6": { ...UNIT, outputs: "100000" } });
  assert.equal(whyOver(form, UNIT), "");
  replace({ "line/6": { ...UNIT, outputs: "010000" } });
  assert.equal(whyOver(form, UNIT), "now on");
});
