"""Side room: the page that shows what a run found."""
