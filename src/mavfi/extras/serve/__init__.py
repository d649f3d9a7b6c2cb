"""`mavfi serve`: ledgers as local pages, with each run flown again when it is clicked.

Starlette and uvicorn serve them (extra `serve`): two small, well-kept packages with few dependencies of their own.
ASGI allows a page to wait for a flight while others are answered, and Starlette's test client calls the application
without a network.  A framework of widgets (Panel, Dash) would bring a second look beside that of the report's pages.
"""
