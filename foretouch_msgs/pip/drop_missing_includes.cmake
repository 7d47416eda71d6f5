# SPDX-License-Identifier: Apache-2.0
# Included after project() when building against the wheels only. Their imported targets still name
# include folders of the machine that built them, and CMake refuses a folder that does not exist.
# Deferred to the end of the directory, when every imported target is known.
function(_foretouch_drop_missing_includes)
  get_property(imported DIRECTORY PROPERTY IMPORTED_TARGETS)
  foreach(target IN LISTS imported)
    get_target_property(folders ${target} INTERFACE_INCLUDE_DIRECTORIES)
    if(folders)
      set(present "")
      foreach(folder IN LISTS folders)
        if(NOT IS_ABSOLUTE "${folder}" OR EXISTS "${folder}")
          list(APPEND present "${folder}")
        endif()
      endforeach()
      set_property(TARGET ${target} PROPERTY INTERFACE_INCLUDE_DIRECTORIES "${present}")
    endif()
  endforeach()
endfunction()
cmake_language(DEFER CALL _foretouch_drop_missing_includes)
