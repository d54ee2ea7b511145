"""Programs for users: terminal commands, browser page, drafts of configurations, demo."""
