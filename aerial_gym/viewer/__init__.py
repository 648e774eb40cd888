"""Live 3-D view in the browser: vehicles, scene and controls on a page of viser. Nothing but ``cli`` depends on it."""
