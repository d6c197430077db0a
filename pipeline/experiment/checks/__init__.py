"""What ``check`` looks at: levels, lines and converter of each channel; wiring, lag and hold from the
response.
"""
