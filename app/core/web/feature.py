"""Pages and files for everyone, signed in or not: static files, the sign of life, and the parts that make the
pages an app on a device (manifest, service worker, the page for no connection).

The service worker keeps nothing but that page: old values must never look like new ones.
"""

from __future__ import annotations

import asyncio
import json
from functools import partial

from fastapi import APIRouter, Depends
from starlette.requests import Request
from starlette.responses import JSONResponse, RedirectResponse, Response

from app.core.web import api as schema
from app.core.web.access import public
from app.core.web.assets import Assets, static_dir, templates_dir
from app.core.web.routes import GuardedRoute, Turns
from app.core.web.services import service_of
from app.core.web.templating import Templates, render, templates_of
from app.feature import Feature, Services

router = APIRouter(dependencies=[Depends(public)], include_in_schema=False, route_class=GuardedRoute)
KEPT = ("css/lineside.css", "js/theme.js", "js/offline.js", "icons/sprite.svg")
"""The files that the service worker keeps, for the page for no connection."""
OFFLINE = "/offline"
FOREVER = "public, max-age=31536000, immutable"


@router.get("/static/{version}/{name:path}")
async def static_file(request: Request, version: str, name: str) -> Response:
    """Send a file under the address that names its version; under another version it is not cached."""
    assets = service_of(request, Assets)
    return assets.get(name).response(request, FOREVER if version == assets.version else "no-cache")


@router.get("/healthz")
async def health() -> dict[str, str]:
    """Respond once the app serves."""
    return {"status": "ok"}


@router.get("/manifest.webmanifest")
async def manifest(request: Request) -> Response:
    """Send the app's name, colors and icons; another name and icon if no drive is connected."""
    assets, templates = service_of(request, Assets), templates_of(request)
    name, unreal = templates.site.name, templates.is_unreal
    icon = "icons/lineside-unreal" if unreal else "icons/lineside"
    content = {
        "name": f"[SIM] {name}" if unreal else name,
        "short_name": "Lineside",
        "start_url": "/",
        "scope": "/",
        "display": "standalone",
        "background_color": "#d6d9db",
        "theme_color": "#5a4a8a" if unreal else "#e4e6e8",
        "icons": [
            {"src": assets.url(f"{icon}.svg"), "sizes": "any", "type": "image/svg+xml"},
            {"src": assets.url(f"{icon}-192.png"), "sizes": "192x192", "type": "image/png"},
            {"src": assets.url(f"{icon}-512.png"), "sizes": "512x512", "type": "image/png"},
        ],
    }
    return JSONResponse(
        content, media_type="application/manifest+json", headers={"Cache-Control": "no-cache"}
    )


@router.get("/sw.js")
async def service_worker(request: Request) -> Response:
    """Send the service worker of the site; it changes with the assets."""
    assets = service_of(request, Assets)
    kept = json.dumps([assets.url(name) for name in KEPT])
    head = f"const OFFLINE = {json.dumps(OFFLINE)};\nconst KEPT = {kept};\n"
    body = head.encode() + assets.get("js/sw.js").body
    return Response(body, media_type="text/javascript", headers={"Cache-Control": "no-cache"})


@router.get(OFFLINE)
async def offline(request: Request) -> Response:
    """Send the page that a device shows while it reaches no server."""
    return render(request, "web/offline.html")


@router.get("/favicon.ico")
async def favicon(request: Request) -> Response:
    """Redirect browsers that request the icon without reading the page."""
    icon = "icons/lineside-unreal.svg" if templates_of(request).is_unreal else "icons/lineside.svg"
    return RedirectResponse(service_of(request, Assets).url(icon))


AFTER_S = 1.0
"""The seconds after the start, which needs the machine."""


async def read_languages(templates: Templates, language: str) -> None:
    """Read the catalog of the site's language and compile the others, before a page needs them: parsing one
    would hold up commands for a tenth of a second."""
    await asyncio.sleep(AFTER_S)
    await asyncio.to_thread(templates.languages[language].read)
    for each in templates.languages:
        await asyncio.to_thread(each.compile)


def make(services: Services) -> None:
    settings = services.settings
    services.add(Turns())
    assets = services.add(Assets(static_dir()))
    templates = services.add(
        Templates(
            templates_dir(),
            assets,
            settings.site,
            demo=services.demo,
            kept_in=settings.server.data / "compiled",
            page_digest=settings.page_digest,
        )
    )
    services.lifespan.add("languages", once=partial(read_languages, templates, settings.site.language))


FEATURE = Feature(make, (router, schema.router))
