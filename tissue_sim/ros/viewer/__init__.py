"""A running node in the browser, and a tool to poke it with."""
