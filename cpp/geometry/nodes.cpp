#include "geometry/nodes.h"
