"""Alarm rules, states, events and notifications."""
