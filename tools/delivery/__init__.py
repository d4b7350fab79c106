"""How a scene gets to a browser: pages that hold it or lie beside it, and a server for one file."""
