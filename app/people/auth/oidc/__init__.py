"""Signing in by a provider of company accounts: OpenID Connect Core 1.0, the authorization code with PKCE."""
