import sys
from pathlib import Path

# Test files are imported one by one (importlib mode); store_runs.py is shared by those of this folder.
sys.path.insert(0, str(Path(__file__).parent))
