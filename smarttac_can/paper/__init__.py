"""What the paper shows, done again: experiments, metrics, figures and the report."""
