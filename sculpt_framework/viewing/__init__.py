"""Looking at runs in the browser: their files read, a scene made of them, a page with what can be steered."""
