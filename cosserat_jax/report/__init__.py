"""Floor 5, report: results as text, figures and files."""
