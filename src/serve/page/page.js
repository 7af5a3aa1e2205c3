
"use strict";
// The label room in a browser. What a person says is kept in this browser until the server has said that it is on disk; the
// number beside it has it count once, however often it is sent (see the server's `room`).
(() => {
  const $ = (id) => document.getElementById(id);
  const token = location.hash.slice(1);

  // ---- what is kept ----------------------------------------------------------------------------------------------------
  // Each tab keeps its own, so that two do not write over each other; whichever opens next takes over what was left.
  const PREFIX = `dropj/${token.slice(0, 8)}/`;
  const tab = (() => {
    try {
      const known = sessionStorage.getItem("dropj-tab");
      if (known) return known;
    } catch { /* none is kept */ }
    const made = [...crypto.getRandomValues(new Uint8Array(8))].map((it) => it.toString(16).padStart(2, "0")).join("");
    try { sessionStorage.setItem("dropj-tab", made); } catch { /* another after a reload */ }
    return made;
  })();
  let queue = []; // what was said and is not acknowledged: {nr, act}
  let isKept = true;

  function save() {
    try {
      if (queue.length) localStorage.setItem(PREFIX + tab, JSON.stringify(queue));
      else localStorage.removeItem(PREFIX + tab);
      isKept = true;
    } catch {
      isKept = false;
    }
  }

  function takeOver() {
    try {
      const left = Object.keys(localStorage).filter((key) => key.startsWith(PREFIX)).sort();
      for (const key of left) {
        const kept = JSON.parse(localStorage.getItem(key));
        if (Array.isArray(kept)) queue.push(...kept.filter((it) => Number.isInteger(it.nr) && it.act));
      }
      queue.sort((a, b) => a.nr - b.nr);
      save();
      left.filter((key) => key !== PREFIX + tab).forEach((key) => localStorage.removeItem(key));
    } catch { /* nothing was left that can be read */ }
  }

  // ---- what is known ---------------------------------------------------------------------------------------------------
  let view = null; // what the server said last
  let connection = "begin"; // "here", "away" or "over"
  let trouble = ""; // a sentence of the server that somebody should read
  let saidHere = null; // what was said last, in words, until the server has its own
  let skippedHere = null; // the query that was skipped last
  let guided = null; // of the guided questions: null, or what was said so far
  let active = null; // justifications for the next preference

  // What is next and what was answered, with what is not acknowledged yet.
  function project() {
    const next = view.next.map((card) => ({ ...card }));
    const latest = view.latest.map((card) => ({ ...card }));
    let nDone = view.n_done;
    const move = (from, to, query) => {
      const at = from.findIndex((card) => card.query === query);
      if (at >= 0) to.unshift(...from.splice(at, 1));
      return at >= 0;
    };
    for (const { act } of queue) {
      if (act.answer) nDone += move(next, latest, act.answer.query);
      if (act.redo) nDone += move(next, latest, act.redo.query);
      if (act.undo) nDone -= move(latest, next, act.undo.query);
      const flag = act.flag ?? act.unflag;
      for (const card of [...next, ...latest]) if (flag && card.query === flag.query) card.is_flagged = Boolean(act.flag);
    }
    return { next, latest, nDone };
  }

  // ---- speaking with the server ----------------------------------------------------------------------------------------
  async function ask(path, body) {
    const options = { headers: { Authorization: `Bearer ${token}` }, cache: "no-store", signal: AbortSignal.timeout(15000) };
    if (body) Object.assign(options, { method: "POST", body: JSON.stringify(body) });
    if (body) options.headers["Content-Type"] = "application/json";
    return fetch(path, options);
  }
  const told = (response) => response.json().catch(() => ({ error: `the server answers ${response.status}` }));

  function isBack() {
    connection = "here";
    wait = 1000;
  }
  function isAway() {
    if (connection !== "over") connection = "away";
    render();
    again();
  }
  function isOver(title, text) {
    connection = "over";
    notice(title, text + (queue.length ? ` ${sayKept()} in this browser.` : ""));
  }
  const sayKept = () => (queue.length === 1 ? "One answer is kept" : `${queue.length} answers are kept`);

  let wait = 1000;
  let timer = null;
  function again() {
    if (timer !== null || connection === "over") return;
    timer = setTimeout(() => { timer = null; pump(); }, wait);
    wait = Math.min(wait * 2, 5000);
  }

  let isPumping = false;
  async function pump() {
    if (isPumping || connection === "over") return;
    isPumping = true;
    try {
      while (await sendOne());
    } finally {
      isPumping = false;
    }
    render();
    fetchClips();
  }

  // Sends what was said first, or asks what is next where nothing is left to send and that is not known. Whether to go on.
  async function sendOne() {
    const first = queue[0];
    if (!first && connection === "here") return false;
    let response, body;
    try {
      response = await (first ? ask("/api/act", { nr: first.nr, act: first.act }) : ask("/api/view"));
      body = await told(response);
    } catch {
      isAway();
      return false;
    }
    if (response.ok) {
      isBack();
      view = body;
      if (first) {
        queue.shift();
        save();
        if (!queue.length) saidHere = null;
      }
    } else if (response.status === 409 && Number.isInteger(body.nr) && body.nr !== first.nr) {
      // Something was said elsewhere: the same again, with the numbers that are next.
      queue.forEach((it, i) => { it.nr = body.nr + i; });
      save();
    } else if (response.status === 401 || response.status === 403) {
      isOver("This link opens nothing", "Ask whoever gave it to you for another.");
      return false;
    } else if ([400, 404, 413, 422].includes(response.status) && first) {
      trouble = `Not taken: ${body.error}`;
      queue.shift();
      save();
      connection = "begin"; // what is next is to be asked anew
    } else {
      trouble = response.status === 503 ? body.error : trouble;
      isAway();
      return false;
    }
    if (view) enter();
    return true;
  }

  // ---- clips -----------------------------------------------------------------------------------------------------------
  const clips = new Map(); // "QUERY/SIDE" → {blob, bitmap, isAsked}
  let nFetching = 0;
  const isSingle = () => view.protocol === "dros" || view.protocol === "request";
  const keysOf = (card) => (isSingle() ? ["left"] : ["left", "right"]).map((side) => `${card.query}/${side}`);

  function fetchClips() {
    if (!view) return;
    const { next, latest } = project();
    const wanted = [...next, ...latest.slice(0, 3)].flatMap(keysOf);
    const near = new Set([...next.slice(0, 3), ...latest.slice(0, 1)].flatMap(keysOf));
    const kept = new Set([...wanted, ...latest.flatMap(keysOf)]);
    for (const [key, clip] of clips) {
      if (!near.has(key) && clip.bitmap) { clip.bitmap.close(); clip.bitmap = null; }
      if (!kept.has(key) && !clip.isAsked) clips.delete(key);
    }
    for (const key of near) decode(key);
    for (const key of wanted) {
      if (nFetching >= 3 || connection !== "here") return;
      if (!clips.has(key)) fetchClip(key);
    }
  }

  async function fetchClip(key) {
    const clip = { blob: null, bitmap: null, isAsked: true };
    clips.set(key, clip);
    nFetching += 1;
    try {
      const response = await ask(`/api/clip/${key}`);
      if (response.ok) clip.blob = await response.blob();
      else if (response.status === 404) { clips.delete(key); connection = "begin"; again(); }
      else { clips.delete(key); trouble = (await told(response)).error; isAway(); }
    } catch {
      clips.delete(key);
      isAway();
    } finally {
      clip.isAsked = false;
      nFetching -= 1;
    }
    fetchClips();
  }

  async function decode(key) {
    const clip = clips.get(key);
    if (!clip?.blob || clip.bitmap || clip.isDecoding) return;
    clip.isDecoding = true;
    try {
      clip.bitmap = await createImageBitmap(clip.blob, { colorSpaceConversion: "none" });
    } catch {
      clips.delete(key);
    }
    clip.isDecoding = false;
  }

  // ---- playing ---------------------------------------------------------------------------------------------------------
  const SPEEDS = [5, 10, 15, 25, 35, 50, 100];
  const USUAL = 25;
  let speed = USUAL;
  let isStanding = false;
  let playhead = 0;
  let loops = 0;
  let shown = null; // {query, nr, at}: since which picture, and when
  let watched = 0; // seconds with it before somebody's eyes
  let touched = performance.now();
  let pictureNr = 0;
  let lastAt = performance.now();

  const isGone = (now) => (now - touched) / 1000 > view.away_after;
  for (const name of ["pointermove", "pointerdown", "keydown", "touchstart", "focus"]) {
    addEventListener(name, () => { touched = performance.now(); }, { passive: true });
  }

  function picture(now) {
    requestAnimationFrame(picture);
    pictureNr += 1;
    const dt = Math.max(0, (now - lastAt) / 1000);
    lastAt = now;
    if (!view || $("room").hidden) return;
    const card = project().next[0];
    const bitmaps = card ? keysOf(card).map((key) => clips.get(key)?.bitmap) : [];
    const isReady = bitmaps.length > 0 && bitmaps.every(Boolean);
    if (!isReady) {
      if (shown) { shown = null; blank(); render(); }
      return;
    }
    if (shown?.query !== card.query) {
      shown = { query: card.query, nr: pictureNr, at: now };
      [loops, isStanding, watched, playhead] = [0, false, 0, card.span[0]];
      if (guided) guided = [];
      render();
    } else if (document.visibilityState === "visible" && document.hasFocus() && !isGone(now)) {
      watched += Math.min(dt, 1);
    }
    if (!isStanding && !isGone(now)) {
      playhead += (Math.min(dt, 0.25) * view.rate * speed) / USUAL;
      const end = card.span[1] + view.rest;
      if (playhead >= end) {
        playhead = card.span[0] + ((playhead - end) % (end - card.span[0]));
        loops += 1;
      }
    }
    draw(card, bitmaps);
  }

  const frame = (card) => Math.min(Math.floor(playhead), (isStanding ? view.n_frames : card.span[1]) - 1);

  function draw(card, bitmaps) {
    const at = frame(card);
    [$("left"), $("right")].slice(0, bitmaps.length).forEach((canvas, i) => {
      const [width, height] = [bitmaps[i].width, bitmaps[i].height / view.n_frames];
      if (canvas.width !== width || canvas.height !== height) {
        [canvas.width, canvas.height] = [width, height];
        document.documentElement.style.setProperty("--aspect", width / height);
      }
      canvas.getContext("2d").drawImage(bitmaps[i], 0, at * height, width, height, 0, 0, width, height);
    });
    $("left").classList.toggle("accent", card.outcome === at || (guided !== null && guided.length === 0));
    [...$("timeline").children].forEach((mark, i) => {
      mark.className = (i === at ? "here" : i < at && i >= (isStanding ? 0 : card.span[0]) ? "played" : "")
        + (i === card.outcome ? " outcome" : "");
    });
  }

  function blank() {
    for (const canvas of [$("left"), $("right")]) canvas.getContext("2d").clearRect(0, 0, canvas.width, canvas.height);
  }

  function isSeen() {
    return shown && pictureNr >= shown.nr + 2 && (performance.now() - shown.at) / 1000 >= view.least_secs;
  }

  // ---- what is said ----------------------------------------------------------------------------------------------------
  function say(act, words) {
    const nr = queue.length ? queue[queue.length - 1].nr + 1 : view.nr;
    queue.push({ nr, act });
    save();
    saidHere = words;
    trouble = "";
    skippedHere = act.answer && "skipped" in act.answer.response ? act.answer.query : null;
    [active, guided] = [null, guided && []];
    render();
    pump();
  }

  function answer(response, words) {
    if (!shown || project().next[0]?.query !== shown.query) return;
    if (!isSeen()) {
      saidHere = "Not taken: this came before the pair could be seen";
      return render();
    }
    const secs = Math.round(watched * 1000) / 1000;
    say({ answer: { query: shown.query, response, secs, loops } }, words);
  }

  const skip = () => answer({ skipped: null }, "skipped: nothing is learned from it");
  function explain(reason, words) {
    const query = skippedQuery();
    if (query !== null) say({ explain: { query, reason } }, `skipped: ${words}`);
  }
  function skippedQuery() {
    return queue.length ? skippedHere : (view.skipped ?? null);
  }
  function undo() {
    if (guided?.length) { guided.pop(); return render(); }
    const last = project().latest[0];
    if (last) say({ undo: { query: last.query } }, "taken back");
  }
  function redo() {
    if (!queue.length && view.redo !== null) say({ redo: { query: view.redo } }, "given back");
  }
  function flag() {
    const card = project().next[0];
    if (card && shown?.query === card.query) say(card.is_flagged ? { unflag: { query: card.query } } : { flag: { query: card.query } }, saidHere);
  }
  function judge(isSafe) {
    if (view.protocol !== "dropj" || guided === null || guided.length >= 2) return;
    if (!isSeen()) return answer(null, "");
    guided.push(isSafe);
    const [left, right] = guided;
    if (guided.length === 2 && !(left && right)) {
      const said = left ? "only_left" : right ? "only_right" : "neither";
      return answer({ safety: said }, SAFETY[said]);
    }
    render();
  }
  function toggle(place) {
    const last = view.justifications.length - 1;
    const now = new Set(active ?? [last]);
    if (place === last) now.clear();
    else now.has(place) ? now.delete(place) : now.add(place);
    if (place !== last) now.delete(last);
    active = now.size ? [...now].sort((a, b) => a - b) : [last];
    render();
  }

  const SAFETY = { only_left: "only left is safe", neither: "neither is safe", only_right: "only right is safe" };
  const SIDES = ["left", "equal", "right"];
  const ARROWS = ["ArrowLeft", "ArrowUp", "ArrowRight"];
  const BETTER = ["Left is better", "Equal", "Right is better"];

  // The answers of the present protocol: [name, key, what to do].
  function choices() {
    const sides = (names, response, words) =>
      SIDES.map((side, i) => [names[i], ARROWS[i], () => answer(response(side), words ? words(names[i]) : names[i].toLowerCase())]);
    const preferred = sides(BETTER, (side) => ({ preferred: side }));
    const both = sides(["Both safe, left better", "Both safe, equal", "Both safe, right better"], (side) => ({ safety: { both: side } }));
    switch (view.protocol) {
      case "drop": return [preferred[0], preferred[2]];
      case "drope": return preferred;
      case "dropj":
        if (guided !== null) {
          return guided.length === 2 ? both
            : [["Yes, it stays safe", "y", () => judge(true)], ["No, it becomes unsafe", "n", () => judge(false)]];
        }
        return [...[["Only left is safe", "a", "only_left"], ["Neither is safe", "s", "neither"], ["Only right is safe", "d", "only_right"]]
          .map(([name, key, said]) => [name, key, () => answer({ safety: said }, SAFETY[said])]), ...both];
      case "dropj-multi": {
        const places = active ?? [view.justifications.length - 1];
        const why = places.map((place) => view.justifications[place]).join(", ");
        return sides(BETTER, (side) => ({ justified: [places.length === 1 ? places[0] : places, side] }),
          (name) => `${name.toLowerCase()}, by ${why}`);
      }
      default:
        return ["unsafe", "neutral", "good"].map((verdict, i) =>
          [view.verdicts[i], ARROWS[i], () => answer({ judged: verdict }, view.verdicts[i].toLowerCase())]);
    }
  }

  function question() {
    switch (view.protocol) {
      case "drop": return "Which clip is better?";
      case "drope": return "Which clip is better, or are they equal?";
      case "dropj":
        if (guided !== null) {
          return ["Does the left clip stay safe?", "Does the right clip stay safe?", "Both are safe. Which is better?"][guided.length];
        }
        return "Which clips stay safe? Where both do, which is better?";
      case "dropj-multi": return "What matters most here, and which clip is better?";
      default: return "Where does the last step of this clip lead?";
    }
  }

  // ---- keys ------------------------------------------------------------------------------------------------------------
  const REASONS = [
    ["hallucinated", "1", "hallucinated", "the dream does not look like the world"],
    ["ambiguous", "2", "ambiguous", "the clips cannot be told apart"],
    ["something else", "3", "other", "another reason"],
  ];
  const TOOLS = {
    edit: [
      ["Skip", " ", skip, () => shown === null],
      ["Undo", "Backspace", undo, () => !(guided?.length || project().latest.length)],
      ["Redo", "r", redo, () => queue.length > 0 || view.redo === null],
      ["Flag", "f", flag, () => shown === null],
    ],
    play: [
      ["Pause", "p", () => { isStanding = !isStanding; render(); }, () => shown === null],
      ["Again", "0", () => { isStanding = false; playhead = project().next[0]?.span[0] ?? 0; render(); }, () => shown === null],
      ["Slower", "[", () => faster(false), () => false],
      ["Faster", "]", () => faster(true), () => false],
      ["One question at a time", "g", () => { guided = guided === null ? [] : null; render(); }, () => false],
    ],
  };
  const STEPS = [["A frame back", ",", () => step(-1)], ["A frame on", ".", () => step(1)]];

  function faster(isFaster) {
    speed = (isFaster ? SPEEDS.find((it) => it > speed) : SPEEDS.findLast((it) => it < speed)) ?? speed;
    render();
  }
  function step(n) {
    if (!shown) return;
    isStanding = true;
    const at = Math.min(Math.floor(playhead), view.n_frames - 1) + n;
    playhead = ((at + view.n_frames) % view.n_frames) + 0.5;
    render();
  }

  const NAMES = { " ": "Space", Backspace: "Back", ArrowLeft: "←", ArrowUp: "↑", ArrowRight: "→" };
  const keyName = (key) => NAMES[key] ?? key.toUpperCase();

  addEventListener("keydown", (event) => {
    if (!view || $("room").hidden || $("help").open) return;
    const isChord = event.ctrlKey || event.metaKey;
    if (isChord && !event.getModifierState("AltGraph")) {
      const key = event.key.toLowerCase();
      if (key === "z" || key === "y") {
        event.preventDefault();
        if (!event.repeat) key === "y" || event.shiftKey ? redo() : undo();
      }
      return;
    }
    // A button that was reached by the keyboard is pressed by it.
    if ([" ", "Enter"].includes(event.key) && document.activeElement?.tagName === "BUTTON") return;
    const key = event.key.length === 1 ? event.key.toLowerCase() : event.key;
    const does = bindings().find(([, bound]) => bound === key)?.[2];
    if (!does) return;
    event.preventDefault();
    if (!event.repeat) does();
  });

  function bindings() {
    const isMulti = view.protocol === "dropj-multi";
    const digits = isMulti ? view.justifications.slice(0, 9).map((name, i) => [name, String(i + 1), () => toggle(i)])
      : REASONS.map(([name, key, reason, words]) => [name, key, () => explain(reason, words)]);
    const guide = view.protocol === "dropj" ? [] : ["g"];
    return [...choices(), ...TOOLS.edit, ...TOOLS.play, ...STEPS, ...digits, ["Keys", "?", showHelp]]
      .filter(([, key]) => !guide.includes(key));
  }

  function showHelp() {
    const rows = bindings().flatMap(([name, key]) => {
      const [dt, dd, kbd] = ["dt", "dd", "kbd"].map((tag) => document.createElement(tag));
      kbd.textContent = keyName(key);
      dd.textContent = name;
      dt.append(kbd);
      return [dt, dd];
    });
    $("help-keys").replaceChildren(...rows);
    $("help").showModal();
  }
  $("keys").addEventListener("click", () => view && showHelp());

  // ---- the page --------------------------------------------------------------------------------------------------------
  function notice(title, text) {
    $("notice-title").textContent = title;
    $("notice-text").textContent = text;
    [$("notice").hidden, $("room").hidden] = [false, true];
    renderState();
  }
  function enter() {
    if (connection !== "over") [$("notice").hidden, $("room").hidden] = [true, false];
  }

  function button(name, key, does, { isDisabled = false, isPressed = null, kind = "" } = {}) {
    const made = document.createElement("button");
    made.type = "button";
    made.className = kind;
    made.append(name);
    made.disabled = isDisabled;
    if (key) {
      const cap = document.createElement("kbd");
      cap.textContent = keyName(key);
      cap.setAttribute("aria-hidden", "true");
      made.append(cap);
      made.setAttribute("aria-keyshortcuts", key === " " ? "Space" : key);
    }
    if (isPressed !== null) made.setAttribute("aria-pressed", isPressed);
    made.addEventListener("click", (event) => {
      // Who points goes on with keys, which are not to press the button again.
      if (event.detail > 0) made.blur();
      does();
    });
    return made;
  }

  // Puts buttons into a group, where they are others than before: who has reached one by the keyboard stays on it.
  function fill(group, buttons, mark) {
    if (group.dataset.mark === mark) return;
    group.dataset.mark = mark;
    const at = [...group.children].indexOf(document.activeElement);
    group.replaceChildren(...buttons);
    if (at >= 0) group.children[Math.min(at, group.children.length - 1)]?.focus();
  }

  function render() {
    if (!view) return renderState();
    const { next, nDone } = project();
    const card = next[0];
    const isReady = shown !== null && card?.query === shown.query;
    $("question").textContent = card ? question() : "";
    $("place").textContent = card?.place ? `transition ${card.place} of its trajectory` : "";
    $("protocol").textContent = view.protocol_name;
    const single = isSingle();
    document.documentElement.style.setProperty("--n", single ? 1 : 2);
    $("clips").classList.toggle("single", single);
    $("right").hidden = single;
    $("left").setAttribute("aria-label", single ? "Clip" : "Left clip");
    const rim = (side, i) => {
      const isAsked = guided !== null && view.protocol === "dropj" && isReady;
      $(side).classList.toggle("accent", isAsked && guided.length === i);
      $(side).classList.toggle("good", isAsked && guided[i] === true);
      $(side).classList.toggle("bad", isAsked && guided[i] === false);
    };
    ["left", "right"].forEach(rim);

    const skipped = skippedQuery();
    const isMulti = view.protocol === "dropj-multi";
    $("said").textContent = skipped !== null && !trouble ? "Skipped, because it was" : trouble || (saidHere ?? view.said ?? "");
    $("reasons").hidden = skipped === null;
    fill($("reasons"), REASONS.map(([name, key, reason, words]) =>
      button(name, isMulti ? null : key, () => explain(reason, words), { kind: "slim" })), String(isMulti));
    $("bar").setAttribute("aria-valuenow", nDone);
    $("bar").setAttribute("aria-valuemax", view.n_all);
    $("fill").style.width = `${(100 * nDone) / Math.max(view.n_all, 1)}%`;
    $("progress").textContent = queue.length ? `${nDone} of ${view.n_all} queries` : view.progress;

    $("waiting").hidden = isReady;
    $("waiting").textContent = card ? (connection === "away" ? "The next clips come when the server is back." : "Drawing the clips…")
      : nDone < view.n_all ? "No more clips are here until the server is back."
        : `All ${view.n_all} queries are answered. Thank you! What was said last can still be taken back.`;

    $("justifications").hidden = !isMulti;
    const places = active ?? [view.justifications.length - 1];
    fill($("justifications"), view.justifications.map((name, i) =>
      button(name, i < 9 ? String(i + 1) : null, () => toggle(i), { isPressed: places.includes(i), kind: "slim" })), places.join());
    const all = choices();
    $("answers").style.setProperty("--columns", Math.min(all.length, 3));
    fill($("answers"), all.map(([name, key, does]) => button(name, key, does, { isDisabled: !isReady })),
      JSON.stringify([all.map(([name]) => name), isReady, places]));
    const tools = (list) => list.filter(([, key]) => key !== "g" || view.protocol === "dropj").map(([name, key, does, isOff]) => {
      const label = name === "Pause" && isStanding ? "Play" : name === "Flag" && card?.is_flagged ? "Flagged" : name;
      const isPressed = key === "g" ? guided !== null : key === "f" ? Boolean(card?.is_flagged) : null;
      return [label, key, does, { isDisabled: isOff(), isPressed, kind: "quiet" }];
    });
    for (const group of ["edit", "play"]) {
      const list = tools(TOOLS[group]);
      const made = list.map((it) => button(...it));
      if (group === "play") {
        const pace = document.createElement("span");
        [pace.id, pace.className, pace.textContent] = ["speed", "small", `${(speed / USUAL).toFixed(1)} ×`];
        made.splice(3, 0, pace);
      }
      fill($(group), made, JSON.stringify([list, speed]));
    }
    if ($("timeline").children.length !== view.n_frames) {
      $("timeline").replaceChildren(...Array.from({ length: view.n_frames }, () => document.createElement("i")));
    }
    $("who").textContent = `${view.annotator} · ${view.session}`;
    renderState();
    fit();
  }

  // How much room all but the clips takes from top to bottom.
  function fit() {
    const room = $("room").getBoundingClientRect();
    if (!room.height) return;
    const parts = [...$("room").children].filter((it) => it !== $("clips") && it.offsetHeight);
    const gaps = (parts.length + 1) * 8 + 24;
    const rest = parts.reduce((sum, it) => sum + it.offsetHeight, 0) + document.querySelector("footer").offsetHeight + gaps;
    document.documentElement.style.setProperty("--rest", `${rest}px`);
  }
  addEventListener("resize", () => view && fit());

  function renderState() {
    const state = $("state");
    const n = queue.length;
    const [kind, words] = connection === "over" ? ["bad", "closed"]
      : connection === "away" ? ["away", n === 0 ? "offline — waiting for the server"
        : `offline — ${n === 1 ? "one answer is" : `${n} answers are`} kept ${isKept ? "here" : "in this tab alone, so leave it open,"} and sent when the server is back`]
        : n > 0 ? ["sending", "sending…"] : view ? ["", `saved · ${view.n_done} done`] : ["sending", "connecting…"];
    if (state.textContent !== words) state.textContent = words;
    state.className = kind;
    document.title = view ? `${n ? "● " : ""}dropj · ${view.annotator}` : "dropj";
  }

  const scrub = (event) => {
    if (!shown || (event.type === "pointermove" && event.buttons === 0)) return;
    const box = $("timeline").getBoundingClientRect();
    isStanding = true;
    playhead = Math.min(Math.max((event.clientX - box.left) / box.width, 0), 0.999) * view.n_frames;
    render();
  };
  $("timeline").addEventListener("pointerdown", scrub);
  $("timeline").addEventListener("pointermove", scrub);

  addEventListener("online", () => { wait = 1000; pump(); });
  addEventListener("hashchange", () => location.reload());
  addEventListener("beforeunload", (event) => { if (queue.length && !isKept) event.preventDefault(); });
  // What was said elsewhere, and whether the server is still there, is looked at now and then.
  setInterval(() => {
    if (document.visibilityState !== "visible" || queue.length || connection !== "here") return;
    connection = "begin";
    pump();
  }, 20000);

  if (token.length < 8) {
    isOver("A link is needed", "Open the whole link that you were given: what stands behind # lets you in.");
  } else {
    takeOver();
    pump();
    requestAnimationFrame(picture);
  }
})();
