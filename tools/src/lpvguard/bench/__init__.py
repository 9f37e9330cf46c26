"""Performance tables; each module measures one part and states the figure it is held to."""
