"""What the live page shows, from status reports: views, figures, alarms, events, history. Pure; times are arguments."""
