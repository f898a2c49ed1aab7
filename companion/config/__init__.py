"""What fleet and vehicle files hold, by subject, and what no single field can say."""
