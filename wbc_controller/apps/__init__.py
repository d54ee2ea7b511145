"""Programs for users: terminal commands, the browser page, drafts of configurations, the demo."""
