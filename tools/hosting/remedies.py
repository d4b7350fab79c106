"""Remedies: the change to a host's configuration for each finding."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Final

HOSTS: Final = {
    "nginx": "nginx",
    "caddy": "Caddy",
    "s3": "S3",
    "r2": "Cloudflare R2",
    "github-pages": "GitHub Pages",
    "http-server": "python -m http.server",
}
"""Display names of the hosts in `REMEDIES`, by key."""

# Prefixes of the Server header, in lower case, and the key of the host.
_SERVERS: Final = (
    ("nginx", "nginx"),
    ("openresty", "nginx"),
    ("caddy", "caddy"),
    ("amazons3", "s3"),
    ("minio", "s3"),
    ("versitygw", "s3"),
    ("cloudflare", "r2"),
    ("github.com", "github-pages"),
    ("simplehttp", "http-server"),
)

_FOLDER: Final = "publish a folder, which needs no ranges: cogsplat convert scene.cogs scene/"
_NO_HEADERS: Final = "headers cannot be set here; another host, or a CDN in front, can set them"
_CORS_S3: Final = (
    'aws s3api put-bucket-cors --bucket BUCKET --cors-configuration \'{"CORSRules": '
    '[{"AllowedOrigins": ["*"], "AllowedMethods": ["GET", "HEAD"], "AllowedHeaders": ["*"], '
    '"ExposeHeaders": ["Content-Range", "ETag"], "MaxAgeSeconds": 86400}]}\''
)
_CORS_R2: Final = (
    "the bucket's settings, CORS policy: AllowedOrigins *, AllowedMethods GET and HEAD, "
    "AllowedHeaders *, ExposeHeaders Content-Range and ETag"
)
_CORS_NGINX: Final = (
    'add_header Access-Control-Allow-Origin "*" always; '
    'add_header Access-Control-Expose-Headers "Content-Range, ETag" always;'
)
_CORS_CADDY: Final = (
    'header Access-Control-Allow-Origin "*"; '
    'header Access-Control-Expose-Headers "Content-Range, ETag"'
)
_NO_GZIP: Final = {
    "nginx": "gzip off; in the location of scenes, or leave their type out of gzip_types",
    "caddy": "no encode for scenes: encode only a matcher such as @text path *.html *.js *.css",
    "s3": "upload without Content-Encoding; in CloudFront, switch off automatic compression",
    "r2": "Cache-Control: no-transform on the objects, and a compression rule without them",
    "github-pages": "cannot be switched off; " + _FOLDER,
}
_CACHE: Final = {
    "nginx": 'location ~ /segments/ { add_header Cache-Control "public, max-age=31536000, '
    'immutable, no-transform" always; }, and "no-cache" for *.cogsm and *.cogs',
    "caddy": '@segments path */segments/*, header @segments Cache-Control "public, '
    'max-age=31536000, immutable, no-transform"; "no-cache" for *.cogsm and *.cogs',
    "s3": "cogsplat upload sets it; by hand: aws s3 cp --cache-control …",
    "r2": "cogsplat upload sets it",
    "github-pages": "fixed at ten minutes for all files",
    "http-server": _NO_HEADERS,
}
_CORS: Final = {
    "nginx": _CORS_NGINX,
    "caddy": _CORS_CADDY,
    "s3": _CORS_S3,
    "r2": _CORS_R2,
    "github-pages": "fixed: allows all origins, exposes no headers",
    "http-server": _NO_HEADERS,
}
_TYPE: Final = {
    "nginx": "types { application/octet-stream cogs cogsm bin; } in the location of scenes",
    "caddy": "header Content-Type application/octet-stream for *.cogs *.cogsm",
    "s3": "cogsplat upload sets it; by hand: aws s3 cp --content-type application/octet-stream",
    "r2": "cogsplat upload sets it",
}
_ETAG: Final = {
    "nginx": "etag on; (the default), and no gzip, which makes ETags weak",
    "caddy": "file_server sends strong ETags; encode makes them weak",
    "http-server": _NO_HEADERS,
}

REMEDIES: Final[Mapping[str, Mapping[str, str]]] = {
    "http-ranges-ignored": {
        "nginx": "no max_ranges 0; and no gzip or proxy_cache without slices for scenes",
        "caddy": "file_server supports ranges; a reverse_proxy needs a backend that does",
        "github-pages": _FOLDER,
        "http-server": "use cogsplat serve or another server with ranges; or " + _FOLDER,
    },
    "http-encoding-range": _NO_GZIP,
    "http-encoding-whole": _NO_GZIP,
    "http-etag-missing": _ETAG,
    "http-etag-weak": _ETAG,
    "http-etag-changes": {
        "nginx": "several servers of one name need files of equal time and size: rsync --times",
        "s3": "a proxy changes it: let the CDN pass on the bucket's ETag",
    },
    "cors-origin": _CORS,
    "cors-expose": _CORS,
    "cors-preflight": {
        "nginx": "if ($request_method = OPTIONS) { add_header Access-Control-Allow-Origin *; "
        "add_header Access-Control-Allow-Headers Range; add_header Access-Control-Max-Age 86400; "
        "return 204; }",
        "caddy": "@preflight method OPTIONS, header @preflight Access-Control-Allow-Headers Range, "
        "respond @preflight 204",
        "s3": _CORS_S3,
        "r2": _CORS_R2,
    },
    "http-type": _TYPE,
    "cache-immutable": _CACHE,
    "cache-manifest": _CACHE,
    "cache-missing": _CACHE,
    "cache-none": _CACHE,
    "http-version": {
        "nginx": "listen 443 ssl http2;",
        "caddy": "leave h2 among the protocols of servers { … }, or leave that line out",
        "s3": "S3 itself speaks HTTP/1.1; CloudFront in front speaks HTTP/2",
    },
    "http-plain": {
        "nginx": "listen 443 ssl; with a certificate, e.g. of certbot",
        "caddy": "a site address without http:// gets a certificate automatically",
        "s3": "the REST endpoint speaks HTTPS, the website endpoint does not",
    },
}
"""Configuration change by finding code, then by key of the host."""


def host_of(server: str) -> str | None:
    """Return the key of the host with a given Server header; None if it is unknown.

    Examples
    --------
    >>> host_of("nginx/1.22.1")
    'nginx'
    """
    found = server.lower()
    return next((host for start, host in _SERVERS if found.startswith(start)), None)


def remedies(codes: Iterable[str], hosts: Iterable[str]) -> dict[str, dict[str, str]]:
    """Return the entries of `REMEDIES` for some finding codes and hosts; codes without are omitted.

    Parameters
    ----------
    codes : iterable of str
        Codes of findings.
    hosts : iterable of str
        Keys of `HOSTS`.
    """
    keys = list(hosts)
    found = {
        code: {host: REMEDIES[code][host] for host in keys if host in REMEDIES[code]}
        for code in dict.fromkeys(codes)
        if code in REMEDIES
    }
    return {code: by_host for code, by_host in found.items() if by_host}
