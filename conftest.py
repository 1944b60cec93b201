"""What is not collected where an extra is missing."""

from importlib.util import find_spec

# Doctests are collected by import, and the page's server is an extra's.
WEB = ("starlette", "uvicorn")
collect_ignore = [] if all(map(find_spec, WEB)) else ["bsp_gp/web/app.py"]
