// What static/js/sw.js has in a service worker, and what the server writes above it (app/core/web/feature.py).

declare const OFFLINE: string;
declare const KEPT: string[];

/** This worker is a service worker. */
interface WorkerGlobalScope {
  readonly clients: Clients;
  skipWaiting(): Promise<void>;
}
interface WorkerGlobalScopeEventMap {
  activate: ExtendableEvent;
  fetch: FetchEvent;
  install: ExtendableEvent;
}
