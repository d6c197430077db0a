"""Tests of a campaign before any fit: levels, drives and clock from the samples; wiring, lag and hold from the response."""
