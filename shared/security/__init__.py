"""Who may ask a service for what: API keys, bearer tokens, and no listening beyond loopback without either."""
