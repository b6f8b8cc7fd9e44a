"""Pages and viewers in the browser, over the same functions as the command line."""
