"""A local application in the browser: match shapes, look at maps, correct them with landmarks."""
