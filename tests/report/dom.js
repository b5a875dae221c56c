// The part of the DOM that the scripts of the pages use. Reads `[page, statements]` as JSON from standard
// input, runs the scripts of the page and then the statements, and prints what these return as JSON.
"use strict";
const VOID = new Set(["meta", "img", "br", "hr", "input", "link"]);
const ENTITIES = {amp: "&", lt: "<", gt: ">", quot: '"'};
const decoded = (text) => text.replace(/&(?:#(\d+)|#x([\da-f]+)|(\w+));/gi, (whole, number, hex, name) =>
  number ? String.fromCodePoint(number) : hex ? String.fromCodePoint(parseInt(hex, 16)) : ENTITIES[name] ?? whole);

class Node {
  parentElement = null;
  get siblings() { return this.parentElement.childNodes; }
  remove() {
    if (this.parentElement) this.siblings.splice(this.siblings.indexOf(this), 1);
    this.parentElement = null;
  }
  before(...nodes) {
    for (const node of nodes) {
      node.remove();
      node.parentElement = this.parentElement;
      this.siblings.splice(this.siblings.indexOf(this), 0, node);
    }
  }
  replaceWith(...nodes) { this.before(...nodes); this.remove(); }
}
class Text extends Node {
  constructor(text) { super(); this.textContent = text; }
}
class Element extends Node {
  childNodes = []; attributes = {}; listeners = {}; shadowRoot = null; type = undefined;
  constructor(tag) { super(); this.localName = tag; }
  append(...nodes) {
    for (const node of nodes) { node.remove(); node.parentElement = this; this.childNodes.push(node); }
  }
  prepend(...nodes) {
    if (this.childNodes.length) this.childNodes[0].before(...nodes);
    else this.append(...nodes);
  }
  get children() { return this.childNodes.filter((node) => node instanceof Element); }
  get textContent() { return this.childNodes.map((node) => node.textContent).join(""); }
  set textContent(text) { this.childNodes = []; this.append(new Text(text)); }
  getAttribute(name) { return this.attributes[name] ?? null; }
  setAttribute(name, value) { this.attributes[name] = String(value); }
  removeAttribute(name) { delete this.attributes[name]; }
  get namespaceURI() { return this.getAttribute("xmlns"); }
  get src() { return this.getAttribute("src"); }
  get alt() { return this.getAttribute("alt"); }
  get dataset() {
    const names = Object.keys(this.attributes).filter((name) => name.startsWith("data-"));
    return Object.fromEntries(names.map((name) => [name.slice(5), this.attributes[name]]));
  }
  get classList() {
    const names = new Set((this.getAttribute("class") ?? "").split(/\s+/).filter(Boolean));
    return {
      contains: (name) => names.has(name),
      toggle: (name, isIn) => { names[isIn ? "add" : "delete"](name); this.setAttribute("class", [...names].join(" ")); },
    };
  }
  get tHead() { return this.children.find((each) => each.localName === "thead"); }
  get tBodies() { return this.children.filter((each) => each.localName === "tbody"); }
  get rows() { return this.children.filter((each) => each.localName === "tr"); }
  get cells() { return this.children.filter((each) => ["th", "td"].includes(each.localName)); }
  attachShadow() { return this.shadowRoot = new Element("#shadow"); }
  getBBox() { return {x: 0, y: 0, width: 10, height: 10}; }
  addEventListener(type, listener) { (this.listeners[type] ??= []).push(listener); }
  dispatchEvent(event) {
    for (const listener of this.listeners[event.type] ?? []) listener(event);
    return !event.defaultPrevented;
  }
  click() { this.dispatchEvent(new Event("click")); }
  matches(selector) {
    const [, tag, className, attribute, operator, value] =
      selector.match(/^(\w+)?(?:\.([\w-]+))?(?:\[([\w-]+)(?:(\^?=)"?(.*?)"?)?\])?$/) ?? this.unknown(selector);
    const found = this.attributes[attribute];
    return (!tag || tag === this.localName) && (!className || this.classList.contains(className)) &&
      (!attribute || (found !== undefined && (!operator || (operator === "=" ? found === value : found.startsWith(value)))));
  }
  unknown(selector) { throw new Error(`not in the stand-in: ${selector}`); }
  querySelectorAll(selector) {
    return this.children.flatMap((each) => [...(each.matches(selector) ? [each] : []), ...each.querySelectorAll(selector)]);
  }
  querySelector(selector) { return this.querySelectorAll(selector)[0] ?? null; }
}

function parsed(text) {
  const root = new Element("#root"), open = [root];
  const tokens = /<!--[^]*?-->|<[!?][^>]*>|<\/([\w:-]+)\s*>|<([\w:-]+)((?:\s+[\w:-]+(?:\s*=\s*(?:"[^"]*"|'[^']*'|[^\s"'>]+))?)*)\s*(\/?)>|[^<]+/g;
  for (let token; (token = tokens.exec(text)); ) {
    const [whole, closed, tag, attributes, empty] = token;
    if (closed) {
      if (open.pop().localName !== closed) throw new Error(`not well-formed at ${whole}`);
    } else if (tag) {
      const element = new Element(tag);
      for (const [, name, , quoted, single, bare] of attributes.matchAll(/([\w:-]+)(\s*=\s*(?:"([^"]*)"|'([^']*)'|([^\s"'>]+)))?/g))
        element.attributes[name] = decoded(quoted ?? single ?? bare ?? "");
      open.at(-1).append(element);
      if (["script", "style"].includes(tag) && !empty) {
        const end = text.indexOf(`</${tag}>`, tokens.lastIndex);
        element.append(new Text(text.slice(tokens.lastIndex, end)));
        tokens.lastIndex = end + tag.length + 3;
      } else if (!empty && !VOID.has(tag)) open.push(element);
    } else if (!whole.startsWith("<")) open.at(-1).append(new Text(decoded(whole)));
  }
  return root;
}

const [page, statements] = JSON.parse(require("fs").readFileSync(0, "utf8"));
globalThis.document = Object.assign(parsed(page), {
  createElement: (tag) => new Element(tag),
  createElementNS: (_, tag) => new Element(tag),
});
globalThis.DOMParser = class {
  parseFromString(text) { return {documentElement: parsed(text).children[0]}; }
};
globalThis.KeyboardEvent = class extends Event {
  constructor(type, {key}) { super(type, {cancelable: true}); this.key = key; }
};
for (const script of document.querySelectorAll("script")) new Function(script.textContent)();
console.log(JSON.stringify(new Function(statements)()));
