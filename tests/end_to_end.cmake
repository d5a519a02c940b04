# Whole programs over LCM, each test in a private network namespace. 77: this machine does not allow one.
add_test(NAME end_to_end COMMAND ${CMAKE_CURRENT_SOURCE_DIR}/end_to_end.sh
    $<TARGET_FILE:trocar-server> $<TARGET_FILE:trocar-device> ${PROJECT_SOURCE_DIR}/meshes/figure8.yaml)
if(TROCAR_SANITIZE)
    set(timing no) # instrumented programs are many times slower: their messages are checked, not their speed
else()
    set(timing yes)
endif()
set_tests_properties(end_to_end PROPERTIES ENVIRONMENT "TROCAR_CHECK_TIMING=${timing}" SKIP_RETURN_CODE 77 TIMEOUT 120 RUN_SERIAL TRUE)
